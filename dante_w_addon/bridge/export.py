"""From the Blender scene to a scene folder: the mesh, the cameras, the photos."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from ..blender import cameras, mesh, photos
from ..contract import scene_folder
from ..contract.errors import BadInput
from ..contract.triangles import write_obj

#: File in a folder that an export made and may replace.
MARK = "made-by-dante-w.txt"


def export_scene(
    scene: bpy.types.Scene, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, folder: Path
) -> Path:
    """Write `obj` and every camera with a photo to `folder`, which is emptied first.

    Returns:
        The path of `transforms.json`.

    Raises:
        BadInput: something cannot be used; the message names it and the fix.
    """
    photo_list = photos.photos_in(scene)
    if not photo_list:
        raise BadInput("No camera has a background image; add photos, or import a scene folder.")
    for photo in photo_list:
        problem = photos.problem(photo)
        if problem:
            raise BadInput(problem)
    _empty(folder)
    write_obj(folder / "mesh.obj", mesh.evaluated_triangles(obj, depsgraph))
    images = photos.Folder(folder / "images")
    frames = [_frame(scene, photo, depsgraph, images) for photo in photo_list]
    return scene_folder.write_scene(
        folder, scene_folder.Scene(folder / "transforms.json", folder / "mesh.obj", frames)
    )


def _frame(
    scene: bpy.types.Scene, photo: photos.Photo, depsgraph: bpy.types.Depsgraph, images: photos.Folder
) -> scene_folder.Frame:
    camera = photo.camera.evaluated_get(depsgraph)  # constraints, drivers and animation applied
    width, height = photos.size_of(photo.image)
    try:
        pose = cameras.pose(camera.matrix_world)
    except BadInput as error:
        raise BadInput(f"Camera {photo.camera.name}: {error}.") from error
    calibration = cameras.calibration(camera.data, width, height, cameras.pixel_aspect(scene))
    return scene_folder.Frame(images.place(photo.image), calibration, pose)


def _empty(folder: Path) -> None:
    """Make `folder` empty, but never delete files that an earlier export did not put there."""
    try:
        if folder.exists() and any(folder.iterdir()):
            if not (folder / MARK).is_file():
                raise BadInput(f"{folder} holds other files; choose another output folder.")
            shutil.rmtree(folder)  # photos are copies or links: the originals stay
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MARK).write_text("Made by DANTE-W; each export replaces this folder.\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{folder} cannot be written: {error.strerror}.") from error
