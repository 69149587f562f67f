"""A small scene for the tests and the window script: an object, cameras around it, rendered photos."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector


def save_picture(path: Path, width: int, height: int, colour=(0.5, 0.4, 0.3, 1.0)) -> None:
    """Write a PNG of one colour."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = bpy.data.images.new("picture", width, height, alpha=True)
    image.pixels.foreach_set(np.tile(np.asarray(colour, np.float32), width * height))
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def add_cube(name: str = "Cube") -> bpy.types.Object:
    """A cube with Blender's own UV map and one grey material, made active."""
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    cube = bpy.context.view_layer.objects.active
    cube.name = name
    cube.data.materials.append(bpy.data.materials.new("Original"))
    return cube


def add_camera(name: str, eye, target=(0.0, 0.0, 0.0), photo: Path | None = None) -> bpy.types.Object:
    """A camera at `eye` that looks at `target`, with `photo` behind it."""
    camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    turn = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y")
    camera.matrix_world = Matrix.Translation(eye) @ turn.to_matrix().to_4x4()
    bpy.context.scene.collection.objects.link(camera)
    if photo is not None:
        set_photo(camera, bpy.data.images.load(str(photo)))
    return camera


def set_photo(camera: bpy.types.Object, image: bpy.types.Image) -> None:
    """Put `image` behind `camera`."""
    background = camera.data.background_images.new()
    background.image = image
    background.frame_method = "CROP"
    camera.data.show_background_images = True


def build(photos: Path, count: int = 4, size: tuple[int, int] = (64, 48)) -> bpy.types.Object:
    """The cube, and `count` cameras around it with plain photos; returns the cube."""
    cube = add_cube()
    for index in range(count):
        photo = photos / f"photo {index}.png"
        save_picture(photo, *size)
        angle = 2.0 * math.pi * index / count
        add_camera(f"Camera {index}", (6.0 * math.cos(angle), 6.0 * math.sin(angle), 3.0), photo=photo)
    scene = bpy.context.scene
    scene.camera = scene.objects["Camera 0"]
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.context.view_layer.objects.active = cube
    bpy.context.view_layer.update()
    return cube
