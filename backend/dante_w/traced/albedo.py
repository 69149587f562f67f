"""The albedo texture from every pixel of the photos, once their lights are known.

Each pixel's colour, less its sheen, is divided by the irradiance at its surface point; the texture is the weighted mean.
Irradiance is taken with the pixel's own face normal and the visibility of its shading point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import prange

from dante_w.color import linear_from_srgb_array
from dante_w.jit import njit_parallel
from dante_w.rays.ray_cache import RayCache
from dante_w.texture.average import PhotoAverage
from dante_w.traced.gloss import sheen
from dante_w.traced.lights import ABSOLUTE, RELATIVE, Lights
from dante_w.traced.shading_points import CLIPPED, ShadingPoints, face_normals, located
from dante_w.traced.transfer import Transfer

#: Albedo is physically below 1; noise in the dark is not.
HIGHEST = 2.0
DARKEST = 1e-4


def albedo_texture(
    cache: RayCache,
    footprints: np.ndarray,
    points: ShadingPoints,
    transfer: Transfer,
    lights: Lights,
    cameras: np.ndarray,
    size: int,
    progress: Callable[[float], None],
) -> np.ndarray:
    """(size, size, 3) float32 linear albedo; texels between photos' pixels are filled.

    Args:
        footprints: (N,) of the cache's samples, as fractions of the texture's side.
    """
    normals = face_normals(cache.surface.positions.numpy())
    mean = PhotoAverage(size, size)
    photos = len(cache.starts) - 1
    for photo in range(photos):
        part = slice(cache.starts[photo], cache.starts[photo + 1])
        face, uv, place = located(cache, part)
        point, light = points.at(uv), lights.light[photo]
        facing = normals[face]
        towards = cameras[photo] - place
        towards = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
        facing = np.where((facing * towards).sum(axis=1, keepdims=True) < 0.0, -facing, facing)
        irradiance = _irradiance(point, facing, transfer.directions, transfer.visible, lights.radiance[light])
        irradiance += lights.bounce[point, light]
        cells, first, back = np.unique(point, return_index=True, return_inverse=True)
        gloss = sheen(
            cells,
            np.full(len(cells), light),
            towards[first],
            points.normal,
            transfer.directions,
            transfer.visible,
            lights.radiance,
        )[back]
        srgb = np.asarray(cache.colour[part], np.float32)
        colour = linear_from_srgb_array(srgb)
        gain = np.float32(np.exp(lights.log_exposure[photo]))
        weight = 1.0 / (RELATIVE**2 + (ABSOLUTE / np.maximum(colour.mean(axis=1), DARKEST)) ** 2)
        weight[(srgb >= CLIPPED).any(axis=1)] *= 1e-3  # still better than nothing
        diffuse = np.maximum(colour / gain - gloss, 0.1 * colour / gain)
        albedo = np.clip(diffuse / np.maximum(irradiance, DARKEST), 0.0, HIGHEST)
        mean.add(uv, albedo, weight * RELATIVE**2, footprints[part] * size)
        progress((photo + 1) / photos)
    return mean.resolve()


def _irradiance(
    point: np.ndarray, normals: np.ndarray, directions: np.ndarray, visible: np.ndarray, radiance: np.ndarray
) -> np.ndarray:
    out = np.zeros((len(point), 3), np.float32)
    _sum_light(point, normals, directions, visible, radiance, out)
    return out


@njit_parallel
def _sum_light(
    point: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
    out: np.ndarray,
) -> None:
    share = np.float32(4.0 / len(directions))
    for m in prange(len(point)):
        n, c = normals[m], point[m]
        for d in range(len(directions)):
            cosine = n[0] * directions[d, 0] + n[1] * directions[d, 1] + n[2] * directions[d, 2]
            amount = share * cosine * visible[c, d]
            if amount > 0.0:
                for channel in range(3):
                    out[m, channel] += amount * radiance[d, channel]
