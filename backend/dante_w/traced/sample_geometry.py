"""Where the samples of a ray cache lie on the surface, and how it is turned there."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel
from dante_w.rays.ray_cache import BARY_STEPS, RayCache, Surface, on_surface


def locate_samples(cache: RayCache, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face (N,), texture coordinate (N, 2) and position in the unit cube (N, 3) of a run of samples."""
    face = np.array(cache.face[part])
    uv, place = np.empty((len(face), 2), np.float32), np.empty((len(face), 3), np.float32)
    corners = cache.surface.uvs.numpy(), cache.surface.positions.numpy()
    on_surface(face, np.asarray(cache.bary[part]), *corners, uv, place)
    return face, uv, place


def shading_normals(
    surface: Surface, face: np.ndarray, bary: np.ndarray, place: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """(N, 3) float32 unit shading normals at surface points `place` (N, 3), given by face (N,) and stored weights (N, 2), on the
    side of the face that a camera at (3,) sees; zero where a face has no area."""
    normals = np.empty((0, 3, 3), np.float32) if surface.normals is None else surface.normals.numpy()
    out = np.empty((len(face), 3), np.float32)
    _shading_normals(
        surface.positions.numpy(), normals, face, bary, place, np.asarray(camera, np.float32), out
    )
    return out


@njit_parallel
def _shading_normals(
    positions: np.ndarray,
    normals: np.ndarray,
    face: np.ndarray,
    bary: np.ndarray,
    place: np.ndarray,
    camera: np.ndarray,
    out: np.ndarray,
) -> None:
    unit = np.float32(1.0 / BARY_STEPS)
    for i in prange(len(face)):
        a, b, c = positions[face[i]].astype(np.float64)
        b, c = b - a, c - a
        x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        away = camera - place[i]
        side = 1.0 if x * away[0] + y * away[1] + z * away[2] >= 0.0 else -1.0
        if len(normals):
            own, second, third = normals[face[i]], bary[i, 0] * unit, bary[i, 1] * unit
            first = np.float32(1.0) - second - third
            n = first * own[0] + second * own[1] + third * own[2]
            if n[0] * x + n[1] * y + n[2] * z > 0.0:  # not so where corners' normals cancel out
                x, y, z = n[0], n[1], n[2]
        length = math.sqrt(x * x + y * y + z * z)
        scale = side / length if length > 0.0 else 0.0
        out[i, 0], out[i, 1], out[i, 2] = scale * x, scale * y, scale * z
