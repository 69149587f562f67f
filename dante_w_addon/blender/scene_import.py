"""A scene folder into Blender: cameras with their photos behind them, and the mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..contract import scene_folder
from . import cameras

#: Beyond this distance from the origin, in its own sizes, a mesh loses its shape in Blender's float32.
FAR = 1e4


@dataclass
class Imported:
    """What was made, and what the user should know."""

    cameras: list[bpy.types.Object] = field(default_factory=list)
    mesh: bpy.types.Object | None = None
    warnings: list[str] = field(default_factory=list)


def import_folder(context: bpy.types.Context, path: Path) -> Imported:
    """Make a collection of cameras, and the mesh, from a scene folder or a transforms file.

    The render size and pixel aspect become those of the first photo; the first camera becomes the scene's.

    Raises:
        BadInput: the folder cannot be read; nothing is made then.
    """
    read = scene_folder.read_scene(path)
    result = Imported()
    collection = bpy.data.collections.new(f"Photos of {read.source.parent.name}")
    context.scene.collection.children.link(collection)
    first = read.frames[0].camera
    fx, fy, _, _ = cameras.pinhole_part(first)
    aspect = fx / fy if abs(fx / fy - 1.0) > 1e-3 else 1.0  # calibration noise is no pixel aspect
    render = context.scene.render
    render.resolution_x, render.resolution_y = first.width, first.height
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)
    exact = cameras.pixel_aspect(context.scene)
    notes: dict[str, int] = {}
    for frame in read.frames:
        note = _camera(frame, collection, exact, result)
        if note:
            notes[note] = notes.get(note, 0) + 1
    result.warnings += [f"{count} of {len(read.frames)} cameras: {note}." for note, count in notes.items()]
    context.scene.camera = result.cameras[0]
    if read.mesh is not None:
        result.mesh = _mesh(context, read.mesh, result)
        if result.mesh is not None:
            result.mesh.name = read.source.parent.name
    centres = np.array([frame.camera_to_world[:3, 3] for frame in read.frames])
    spread = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    for camera in result.cameras:  # drawn large enough to pick, small enough to see the mesh
        camera.data.display_size = 0.05 * spread or 1.0
    if np.abs(centres).max() > FAR * max(np.ptp(centres, axis=0).max(), 1e-30):
        result.warnings.append(
            "The scene lies far from the origin, where Blender is not exact; recover the folder itself with "
            "the dante-w command, or move it to the origin."
        )
    return result


def _camera(
    frame: scene_folder.Frame, collection: bpy.types.Collection, aspect: float, result: Imported
) -> str | None:
    data = bpy.data.cameras.new(frame.image.stem)
    camera = bpy.data.objects.new(frame.image.stem, data)
    camera.matrix_world = Matrix(frame.camera_to_world.tolist())
    collection.objects.link(camera)
    note = cameras.set_intrinsics(data, frame.camera, aspect)
    try:
        image = bpy.data.images.load(str(frame.image), check_existing=True)
    except RuntimeError:
        result.warnings.append(f"{frame.image} is missing or unreadable.")
    else:
        background = data.background_images.new()
        background.image = image
        background.frame_method = "CROP"
        background.alpha = 1.0
        data.show_background_images = True
    result.cameras.append(camera)
    return note


def _mesh(context: bpy.types.Context, path: Path, result: Imported) -> bpy.types.Object | None:
    before = set(bpy.data.objects)
    readers = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import}
    try:
        if path.suffix.lower() in readers:  # as it is: both default to turning the axes
            readers[path.suffix.lower()](filepath=str(path), forward_axis="Y", up_axis="Z")
        else:
            bpy.ops.import_scene.gltf(filepath=str(path))
    except (RuntimeError, AttributeError) as error:
        result.warnings.append(f"{path.name} could not be imported: {error}")
        return None
    made = [obj for obj in bpy.data.objects if obj not in before and obj.type == "MESH"]
    if not made:
        result.warnings.append(f"{path.name} holds no mesh.")
        return None
    if path.suffix.lower() == ".glb":  # the importer turned y up into z up; the poses are in the file's axes
        for obj in made:
            obj.matrix_world = Matrix.Rotation(-math.pi / 2.0, 4, "X") @ obj.matrix_world
    context.view_layer.objects.active = made[0]
    return made[0]
