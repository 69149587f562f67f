"""Finished previews: labelled, tiled, and put into the user's file as one picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import blf
import bpy
import imbuf
import numpy as np

from . import hdris

GAP = 4  # pixels between the tiles of a contact sheet
THUMBNAIL = 256  # pixels, as large as Blender's previews get


def contact_sheet(pictures: Sequence[np.ndarray], columns: int = 0) -> np.ndarray:
    """Tile equally large pictures (H, W, C), the first one top left, as rows from the bottom as Blender has them."""
    side = math.ceil(math.sqrt(len(pictures)))
    even = (columns for columns in range(side, 2 * side) if len(pictures) % columns == 0)  # no empty place
    columns = columns or next(even, side)
    rows = math.ceil(len(pictures) / columns)
    height, width, channels = pictures[0].shape
    sheet = np.zeros((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, channels), np.float32)
    sheet[..., 3:] = 1.0
    for index, picture in enumerate(pictures):
        row, column = rows - 1 - index // columns, index % columns
        y, x = row * (height + GAP), column * (width + GAP)
        sheet[y : y + height, x : x + width] = picture
    return sheet


def read_picture(path: Path) -> np.ndarray:
    """Pixels (H, W, 4) of an image file, as stored, rows from the bottom."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(image.size[1], image.size[0], -1)
    finally:
        bpy.data.images.remove(image)


def keep_picture(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Put pixels (H, W, 4) into the packed image datablock `name`, made anew where the size differs.

    The image gets a thumbnail for the panel.
    """
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(name)
    if image is not None and tuple(image.size) != (width, height):
        bpy.data.images.remove(image)
        image = None
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    image.pack()
    step = -(-max(width, height) // THUMBNAIL)
    small = np.ascontiguousarray(pixels[::step, ::step])
    preview = image.preview_ensure()
    preview.image_size = small.shape[1], small.shape[0]
    preview.image_pixels_float.foreach_set(small.ravel())
    return image


def write_label(path: Path, text: str) -> None:
    """Write `text` into the lower left corner of an image file, where this Blender can (4.3 and later)."""
    if not hasattr(blf, "bind_imbuf"):
        return
    picture = imbuf.load(str(path))
    height = max(picture.size[1] // 14, 8)
    with blf.bind_imbuf(0, picture, display_name="sRGB"):
        blf.size(0, height)
        outline = [(x, y, 0.0) for x in (-1, 0, 1) for y in (-1, 0, 1)]  # readable on any background
        for x, y, shade in (*outline, (0, 0, 1.0)):
            blf.color(0, shade, shade, shade, 1.0)
            blf.position(0, height // 2 + x, height // 2 + y, 0)
            blf.draw_buffer(0, text)
    imbuf.write(picture, filepath=str(path))
    picture.free()


def take_pictures(files: Sequence[Path], lights: Sequence[Path]) -> np.ndarray:
    """One rendered file as it is; several as a contact sheet, each with its light's name."""
    if len(files) == 1:
        return read_picture(files[0])
    for file, light in zip(files, lights, strict=True):
        write_label(file, hdris.title(light.stem))
    return contact_sheet([read_picture(file) for file in files])
