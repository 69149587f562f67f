"""A picture of an object put back onto the object from the camera that took it. Needs bpy."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np

MARGIN = 4  # pixels beyond the object that take its colours: more than a pixel filter reaches


def screen_image(picture: Path, mask: Path) -> bpy.types.Image:
    """`picture` (sRGB; its alpha ignored) as an image to be seen in window coordinates.

    What lies outside the object in it may be anything. Pixels that the object does not fill, by the alpha of
    `mask`, therefore take the mean colour of their filled neighbours, MARGIN pixels far.
    """
    colours, alpha = pixels(picture)[..., :3], pixels(mask)[..., 3]
    if colours.shape[:2] != alpha.shape:
        have, want = (f"{shape[1]} x {shape[0]}" for shape in (colours.shape, alpha.shape))
        sys.exit(f"{picture}: is {have} pixels, the test view is {want}; resample it.")
    grown = grow(colours, alpha > 0.999, MARGIN)
    rgba = np.concatenate([grown, np.ones((*grown.shape[:2], 1))], axis=2)
    image = bpy.data.images.new(picture.stem, grown.shape[1], grown.shape[0])
    image.colorspace_settings.name = "sRGB"
    image.pixels.foreach_set(rgba.astype(np.float32).ravel())
    image.update()
    return image


def pixels(file: Path) -> np.ndarray:
    """(H, W, 4) as they stand in the file, bottom row first."""
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"  # colours where alpha is 0 stay what they are
    width, height = image.size
    flat = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(flat)
    bpy.data.images.remove(image)
    return flat.reshape(height, width, 4)


def grow(colours: np.ndarray, known: np.ndarray, steps: int) -> np.ndarray:
    """(H, W, 3) `colours`, those not `known` (H, W) replaced by the mean of known neighbours, `steps` times."""
    height, width = known.shape
    colours = np.where(known[..., None], colours, 0.0)
    for _ in range(steps):
        padded = np.pad(np.dstack([colours, known]), ((1, 1), (1, 1), (0, 0)))
        around = sum(padded[y : y + height, x : x + width] for y in range(3) for x in range(3))
        count = around[..., 3:]
        fresh = ~known & (count[..., 0] > 0)
        colours = np.where(fresh[..., None], around[..., :3] / np.maximum(count, 1), colours)
        known = known | fresh
    return colours
