"""Recover the diffuse albedo texture of a UV-mapped mesh from posed photos (DANTE-W).

The package never imports bpy. `scene_folder` needs nothing beyond numpy, so that the Blender add-on
can use the very same module.
"""

__version__ = "0.1.0"
