"""Where light is computed: one point of the surface per cell of a coarse grid over the texture.

Irradiance varies slowly over the surface, so it is solved for at some ten thousand points instead of millions
of pixels. Photos are averaged over the cells for that; the albedo itself is made from every pixel later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dante_w.color import linear_from_srgb_array
from dante_w.rays.ray_cache import RayCache
from dante_w.traced.robust import ALL, CLIPPED, NEAR_EDGE, Weights

#: Cells along either side of the texture.
SIDE = 256


@dataclass(frozen=True)
class ShadingPoints:
    """C points. `point_of_cell` (SIDE * SIDE,) int32 is -1 for cells that no photo sees; `position` (C, 3) in the
    unit cube; `normal` (C, 3), on the side that the photos see. float32."""

    point_of_cell: np.ndarray
    position: np.ndarray
    normal: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    def at(self, uv: np.ndarray) -> np.ndarray:
        """(N,) int32: the point in whose cell each of the texture coordinates (N, 2) lies, or -1."""
        return self.point_of_cell[cells(uv)]

    def towards(self, point: np.ndarray, camera: np.ndarray) -> np.ndarray:
        """(N, 3) float32 unit vectors from points (N,) to camera centres (N, 3), or to one (3,)."""
        away = camera - self.position[point]
        return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True), np.float32)


@dataclass(frozen=True)
class Observations:
    """What photos see of the points, one row per photo and point, photo after photo: `point` and `photo` (M,)
    int32, `colour` (M, 3) mean linear colour, `pixels` (M,) how many were averaged, `clipped` (M,) whether any was
    too bright for the photo. Pixels beside an edge in depth are left out; where there are no others, `pixels` is 0 and
    `colour` theirs."""

    point: np.ndarray
    photo: np.ndarray
    colour: np.ndarray
    pixels: np.ndarray
    clipped: np.ndarray

    def of(self, chosen: np.ndarray) -> Observations:
        """The rows for which `chosen` (M,) bool holds."""
        return Observations(
            self.point[chosen],
            self.photo[chosen],
            self.colour[chosen],
            self.pixels[chosen],
            self.clipped[chosen],
        )


def cells(uv: np.ndarray) -> np.ndarray:
    """(N,) the grid cell of texture coordinates (N, 2)."""
    column, row = (np.clip(uv * SIDE, 0, SIDE - 1).astype(np.int32)).T
    return row * SIDE + column


def gather(
    cache: RayCache, cameras: np.ndarray, weights: Weights = ALL
) -> tuple[ShadingPoints, Observations]:
    """The shading points of a scene and what its photos see of them.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
    """
    corners = cache.surface.positions.numpy()
    normals = face_normals(corners)
    count = SIDE * SIDE
    nearest = np.full(count, np.inf)  # distance of the best point so far from its cell's centre
    position, normal = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
    rows = []
    for photo, (first, end) in enumerate(zip(cache.starts[:-1], cache.starts[1:], strict=True)):
        face, uv, place = located(cache, slice(first, end))
        cell = cells(uv)
        offset = np.square(uv * SIDE - np.floor(uv * SIDE) - 0.5).sum(axis=1)
        order = np.lexsort((offset, cell))
        here, start = np.unique(cell[order], return_index=True)
        best = order[start]
        better = offset[best] < nearest[here]
        here_better, best = here[better], best[better]
        nearest[here_better] = offset[best]
        position[here_better] = place[best]
        facing = normals[face[best]]
        towards = np.einsum("ij,ij->i", facing, cameras[photo] - place[best]) >= 0.0
        normal[here_better] = np.where(towards[:, None], facing, -facing)
        clear = np.ones(end - first, bool)
        if weights.edge and cache.edge is not None:
            clear = np.asarray(cache.edge[first:end]) >= NEAR_EDGE
        rows.append(_averaged(photo, cell, np.asarray(cache.colour[first:end], np.float32), clear))
    used = np.flatnonzero(np.isfinite(nearest))
    point_of_cell = np.full(count, -1, np.int32)
    point_of_cell[used] = np.arange(len(used))
    cell, photo_of, colour, pixels, clipped = (np.concatenate(column) for column in zip(*rows, strict=True))
    seen = Observations(point_of_cell[cell], photo_of, colour, pixels, clipped)
    return ShadingPoints(point_of_cell, position[used], normal[used]), seen


def located(cache: RayCache, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face (N,), texture coordinate (N, 2) and position in the unit cube (N, 3) of a run of samples."""
    face = np.asarray(cache.face[part])
    second_third = np.asarray(cache.bary[part], np.float32) / 65535.0
    weights = np.column_stack([1.0 - second_third.sum(axis=1), second_third])[:, None, :]
    uv = (weights @ cache.surface.uvs.numpy()[face])[:, 0]
    return face, uv, (weights @ cache.surface.positions.numpy()[face])[:, 0]


def face_normals(corners: np.ndarray) -> np.ndarray:
    """(F, 3) float32 unit normals of faces (F, 3, 3); zero where a face has no area."""
    edges = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edges[:, 0].astype(np.float64), edges[:, 1])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.asarray(cross / np.where(length > 0.0, length, 1.0), np.float32)


def _averaged(photo: int, cell: np.ndarray, srgb: np.ndarray, clear: np.ndarray) -> tuple[np.ndarray, ...]:
    """One photo's mean colours by cell: cell, photo, colour, pixels, clipped. `clear` (N,) bool: not beside an edge."""
    here, index = np.unique(cell, return_inverse=True)
    pixels = np.bincount(index, clear, len(here))
    counts = clear | (pixels[index] == 0)
    linear = linear_from_srgb_array(srgb)
    total = np.stack([np.bincount(index, counts * channel, len(here)) for channel in linear.T], axis=1)
    colour = np.asarray(total / np.bincount(index, counts, len(here))[:, None], np.float32)
    clipped = np.bincount(index, counts & (srgb >= CLIPPED).any(axis=1), len(here)) > 0
    photos = np.full(len(here), photo, np.int32)
    return here, photos, colour, pixels.astype(np.int32), clipped
