"""A photographer's studio in Cycles: one object, one camera, one lighting at a time. Runs where bpy does."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import bpy
import numpy as np
from lights import Lighting
from mathutils import Matrix

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def shipped_hdris() -> Path:
    """The folder of the CC0 HDRIs that come with every Blender."""
    return Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"


def open_studio(size: int, fov: float, samples: int, transparent: bool = True) -> None:
    """An empty scene with a camera and Cycles, its photos `size` pixels square, with plain sRGB colours."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_light_tree = False  # built by threads in no fixed order, and here are two lights at most
    scene.cycles.use_denoising = has_denoiser()
    scene.cycles.denoising_prefilter = "FAST"  # a tenth of the usual time, hardly worse
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = transparent
    scene.render.use_persistent_data = True
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "8"
    scene.view_settings.view_transform = "Standard"  # AgX or Filmic would bend the colours
    scene.view_settings.look = "None"
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.data.angle = fov
    scene.camera.data.clip_start, scene.camera.data.clip_end = 1e-4, 1e4
    scene.collection.objects.link(scene.camera)


def has_denoiser() -> bool:
    """Whether this build has OpenImageDenoise; Debian's has not."""
    import _cycles

    return bool(_cycles.with_openimagedenoise)


def set_lighting(lighting: Lighting, hdris: dict[str, Path]) -> None:
    """Replace the world and the sun by those of `lighting`."""
    scene = bpy.context.scene
    world = scene.world = bpy.data.worlds.new(lighting.hdri)
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    coordinates = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value[2] = lighting.rotation
    image = nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(str(hdris[lighting.hdri]), check_existing=True)
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], image.inputs["Vector"])
    links.new(image.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])

    for lamp in [thing for thing in scene.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    if lighting.sun_irradiance > 0.0:
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        sun.data.energy = lighting.sun_irradiance
        sun.data.angle = math.radians(0.8)
        sun.rotation_euler = (0.5 * math.pi - lighting.sun_elevation, 0.0, lighting.sun_azimuth)
        scene.collection.objects.link(sun)


def sky_irradiance(hdri: Path) -> float:
    """Luminance of the light that falls on level ground under an equirectangular HDRI."""
    image = bpy.data.images.load(str(hdri), check_existing=True)
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    rows = pixels.reshape(height, width, 4)[..., :3] @ LUMINANCE  # the first row is straight down
    elevation = ((np.arange(height) + 0.5) / height - 0.5) * math.pi
    weight = np.clip(np.sin(elevation), 0.0, None) * np.cos(elevation)
    return float((rows.mean(axis=1) * weight).sum() * 2.0 * math.pi * math.pi / height)


def lit_material(
    texture: bpy.types.Image, roughness: float = 1.0, specular: float = 0.0, on_screen: bool = False
) -> bpy.types.Material:
    """`texture` as the albedo of a Principled BSDF; purely diffuse as it stands.

    `on_screen`: the texture is what the camera sees, and lies on the object as if projected from there.
    """
    material, nodes, links, image = _textured(texture)
    if on_screen:
        coordinates = nodes.new("ShaderNodeTexCoord")
        links.new(coordinates.outputs["Window"], image.inputs["Vector"])
        image.extension = "EXTEND"
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = specular
    links.new(image.outputs["Color"], shader.inputs["Base Color"])
    links.new(shader.outputs["BSDF"], nodes["Material Output"].inputs["Surface"])
    return material


def albedo_material(texture: bpy.types.Image) -> bpy.types.Material:
    """`texture` as light of its own, so that a render shows the albedo itself."""
    material, nodes, links, image = _textured(texture)
    shader = nodes.new("ShaderNodeEmission")
    links.new(image.outputs["Color"], shader.inputs["Color"])
    links.new(shader.outputs["Emission"], nodes["Material Output"].inputs["Surface"])
    return material


def _textured(texture: bpy.types.Image):
    material = bpy.data.materials.new(texture.name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    nodes.new("ShaderNodeOutputMaterial")
    image = nodes.new("ShaderNodeTexImage")
    image.image = texture
    return material, nodes, links, image


def wear(thing: bpy.types.Object, material: bpy.types.Material) -> None:
    """Give `thing` that one material."""
    thing.data.materials.clear()
    thing.data.materials.append(material)


def load_mesh(path: Path, up: str = "Z") -> bpy.types.Object:
    """Import an OBJ, PLY or GLB as one object with its transform applied; `up` is an OBJ's or PLY's up axis.

    Ends the program with a sentence where the file holds no mesh that can be read.
    """
    axes = (
        {"forward_axis": "Y", "up_axis": "Z"} if up == "Z" else {"forward_axis": "NEGATIVE_Z", "up_axis": "Y"}
    )
    before = set(bpy.data.objects)
    with quiet():
        if path.suffix.lower() == ".obj":
            bpy.ops.wm.obj_import(filepath=str(path), **axes)
        elif path.suffix.lower() == ".ply":
            bpy.ops.wm.ply_import(filepath=str(path), **axes)
        else:
            bpy.ops.import_scene.gltf(filepath=str(path))
    meshes = [thing for thing in bpy.data.objects if thing not in before and thing.type == "MESH"]
    if not any(len(thing.data.polygons) for thing in meshes):
        sys.exit(f"{path}: holds no mesh that can be read.")
    return join(meshes)


def join(meshes: list[bpy.types.Object]) -> bpy.types.Object:
    """One mesh object out of several, in world space."""
    bpy.ops.object.select_all(action="DESELECT")
    for thing in meshes:
        thing.select_set(True)
    bpy.context.view_layer.objects.active = meshes[0]
    if len(meshes) > 1:
        bpy.ops.object.join()
    bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    return bpy.context.object


def photograph(
    path: Path, camera_to_world: np.ndarray, gain: float = 1.0, samples: int | None = None, seed: int = 0
) -> None:
    """Render to `path` with linear colours times `gain`; a file with that name is always whole."""
    scene = bpy.context.scene
    scene.camera.matrix_world = Matrix(camera_to_world.tolist())
    scene.view_settings.exposure = math.log2(gain)
    scene.cycles.seed = seed
    usual = scene.cycles.samples, scene.cycles.use_denoising
    if samples is not None:
        scene.cycles.samples, scene.cycles.use_denoising = samples, False
    partial = path.with_name(path.stem + ".partial.png")
    scene.render.filepath = str(partial)
    with quiet():
        bpy.ops.render.render(write_still=True)
    scene.cycles.samples, scene.cycles.use_denoising = usual
    partial.write_bytes(without_notes(partial.read_bytes()))
    os.replace(partial, path)


def without_notes(png: bytes) -> bytes:
    """A PNG without the chunks that hold render times and the like: same settings, same bytes."""
    kept, start = png[:8], 8
    while start < len(png):
        end = start + 12 + int.from_bytes(png[start : start + 4], "big")
        if png[start + 4 : start + 8] in (b"IHDR", b"IDAT", b"IEND"):
            kept += png[start:end]
        start = end
    return kept


class quiet:
    """Hold back what C++ writes to stdout within the block."""

    def __enter__(self) -> None:
        self.kept = os.dup(1)
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        os.close(sink)

    def __exit__(self, *_: object) -> None:
        os.dup2(self.kept, 1)
        os.close(self.kept)
