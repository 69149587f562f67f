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

#: Beyond this distance from the origin, as a multiple of its own size, a scene loses its shape in Blender's float32.
FAR = 1e4


@dataclass
class ImportResult:
    """New cameras and mesh, and sentences for the user."""

    cameras: list[bpy.types.Object] = field(default_factory=list)
    mesh: bpy.types.Object | None = None
    warnings: list[str] = field(default_factory=list)


def import_folder(context: bpy.types.Context, path: Path) -> ImportResult:
    """Make a collection of cameras, and the mesh, from a scene folder or a transforms file.

    The render size and pixel aspect become those of the first photo; the first camera becomes the scene's.

    Raises:
        BadInput: the folder cannot be read; nothing is made then.
    """
    scene = scene_folder.read_scene(path)
    result = ImportResult()
    collection = bpy.data.collections.new(f"Photos of {scene.source.parent.name}")
    context.scene.collection.children.link(collection)
    first = scene.frames[0].camera
    fx, fy, _, _ = cameras.pinhole_part(first)
    aspect = fx / fy if abs(fx / fy - 1.0) > 1e-3 else 1.0  # calibration noise is no pixel aspect
    render = context.scene.render
    render.resolution_x, render.resolution_y = first.width, first.height
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)
    aspect = cameras.pixel_aspect(context.scene)  # as Blender has rounded it
    notes: dict[str, int] = {}
    for frame in scene.frames:
        note = _camera(frame, collection, aspect, result)
        if note:
            notes[note] = notes.get(note, 0) + 1
    result.warnings += [f"{count} of {len(scene.frames)} cameras: {note}." for note, count in notes.items()]
    context.scene.camera = result.cameras[0]
    if scene.mesh is not None:
        result.mesh = _mesh(context, scene.mesh, result)
        if result.mesh is not None:
            result.mesh.name = scene.source.parent.name
    centres = np.array([frame.camera_to_world[:3, 3] for frame in scene.frames])
    spread = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    for camera in result.cameras:  # drawn large enough to pick, small enough to see the mesh
        camera.data.display_size = 0.05 * spread or 1.0
    if np.abs(centres).max() > FAR * max(np.ptp(centres, axis=0).max(), 1e-30):
        result.warnings.append(
            "The scene lies far from the origin, where Blender loses precision; recover the folder itself with "
            "the dante-w command, or move it to the origin."
        )
    return result


def _camera(
    frame: scene_folder.Frame, collection: bpy.types.Collection, aspect: float, result: ImportResult
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


def _mesh(context: bpy.types.Context, path: Path, result: ImportResult) -> bpy.types.Object | None:
    old_objects = set(bpy.data.objects)
    readers = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import}
    try:
        if path.suffix.lower() in readers:  # both turn the axes unless told otherwise
            readers[path.suffix.lower()](filepath=str(path), forward_axis="Y", up_axis="Z")
        else:
            bpy.ops.import_scene.gltf(filepath=str(path))
    except (RuntimeError, AttributeError) as error:
        result.warnings.append(f"{path.name} could not be imported: {error}")
        return None
    meshes = [obj for obj in bpy.data.objects if obj not in old_objects and obj.type == "MESH"]
    if not meshes:
        result.warnings.append(f"{path.name} holds no mesh.")
        return None
    if path.suffix.lower() == ".glb":  # the importer turned y up into z up; the poses are in the file's axes
        for obj in meshes:
            obj.matrix_world = Matrix.Rotation(-math.pi / 2.0, 4, "X") @ obj.matrix_world
    context.view_layer.objects.active = meshes[0]
    return meshes[0]
