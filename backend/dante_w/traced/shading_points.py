"""Where light is computed: one point of the surface per cell of a coarse grid over the texture.

Irradiance varies slowly over the surface, so it is solved for at some ten thousand points instead of millions
of pixels. Photos are averaged over the cells for that; the albedo itself is made from every pixel later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dante_w.core.jit import njit
from dante_w.rays.ray_cache import RayCache
from dante_w.traced.observations import (
    USUAL_THINNING,
    Observations,
    ThinningSettings,
    average_over_cells,
    thinned,
)
from dante_w.traced.pixel_weights import USUAL, PixelWeightSettings
from dante_w.traced.sample_geometry import locate_samples, shading_normals


@dataclass(frozen=True)
class ShadingSettings:
    """How many shading points there are, and which photos see them.

    Attributes:
        side: cells along either side of the texture, at most. `bench tradeoff` has what more and fewer cost and bring.
        pixel_quantile: cells are no finer than this part of the samples' footprints, or photos would hardly ever show
            the same ones.
        other_side: a photo sees a point's other side from this cosine down; a cell is not quite flat.
        thinning: what is kept of points that very many photos see.
        weights: which pixels count in a cell's mean.
    """

    side: int = 256
    pixel_quantile: float = 0.75
    other_side: float = -0.2
    thinning: ThinningSettings = USUAL_THINNING
    weights: PixelWeightSettings = USUAL


USUAL_SHADING = ShadingSettings()


@dataclass(frozen=True)
class ShadingPoints:
    """C points.

    Attributes:
        point_of_cell: (side * side,) int32, -1 for cells that no photo sees.
        position: (C, 3) float32 in the unit cube.
        normal: (C, 3) float32 unit vectors for shading, on the side that the photos see.
    """

    point_of_cell: np.ndarray
    position: np.ndarray
    normal: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    @property
    def side(self) -> int:
        """Cells along either side of the texture."""
        return math.isqrt(len(self.point_of_cell))

    def at(self, uv: np.ndarray) -> np.ndarray:
        """(N,) int32: the point in whose cell each of the texture coordinates (N, 2) lies, or -1."""
        return self.point_of_cell[cells(uv, self.side)]

    def towards(self, point: np.ndarray, camera: np.ndarray) -> np.ndarray:
        """(N, 3) float32 unit vectors from points (N,) to camera centres (N, 3), or to one (3,)."""
        away = camera - self.position[point]
        length = np.linalg.norm(away, axis=1, keepdims=True)
        safe = np.where(length > 0.0, length, 1.0)  # a camera may be on the surface
        return np.asarray(away / safe, np.float32)


def cells(uv: np.ndarray, side: int) -> np.ndarray:
    """(N,) the grid cell of texture coordinates (N, 2) in a grid of side x side."""
    column, row = (np.clip(uv * side, 0, side - 1).astype(np.int32)).T
    return row * side + column


def gather(
    cache: RayCache, cameras: np.ndarray, settings: ShadingSettings = USUAL_SHADING
) -> tuple[ShadingPoints, Observations]:
    """The shading points of a scene and what its photos show of them, thinned where very many photos show a point.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
    """
    side = _grid_side(cache, settings)
    count = side * side
    nearest = np.full(count, np.inf, np.float32)  # distance of the best sample so far from its cell's centre
    position, normal = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
    rows: list[tuple[np.ndarray, ...]] = []
    held = 0
    for photo in range(len(cache.starts) - 1):
        part = slice(cache.starts[photo], cache.starts[photo + 1])
        face, uv, place = locate_samples(cache, part)
        cell = cells(uv, side)
        improved, best = _nearest_to_centres(cell, uv, side, nearest)
        position[improved] = place[best]
        bary = np.asarray(cache.bary[part])[best]
        normal[improved] = shading_normals(cache.surface, face[best], bary, place[best], cameras[photo])
        shown = average_over_cells(cache, part, cell, count, settings.weights)
        rows.append((shown[0], np.full(len(shown[0]), photo, np.int32), *shown[1:]))
        held += len(shown[0])
        cache.forget()
        if held > 2 * settings.thinning.rows_held:  # memory does not grow with photos
            rows = [_thinned_rows(rows, side, settings.thinning)]
            held = len(rows[0][0])
    cell, photo_of, colour, pixels, clipped = _thinned_rows(rows, side, settings.thinning)
    used = np.flatnonzero(np.isfinite(nearest))
    point_of_cell = np.full(count, -1, np.int32)
    point_of_cell[used] = np.arange(len(used))
    observations = Observations(point_of_cell[cell], photo_of, colour, pixels, clipped, cache.log_gain)
    points = ShadingPoints(point_of_cell, position[used], normal[used])
    return _on_one_side(points, observations, cameras, settings.other_side)


def _grid_side(cache: RayCache, settings: ShadingSettings) -> int:
    """Cells along either side of the texture that suit the photos' pixels."""
    most = settings.side
    if cache.footprint is None or len(cache) == 0:
        return most
    some = np.asarray(cache.footprint[:: max(len(cache) >> 17, 1)], np.float32)
    wide = float(np.quantile(some, settings.pixel_quantile))
    return min(max(int(1.0 / wide), 1), most) if wide > 0.0 else most


def _on_one_side(
    points: ShadingPoints, observations: Observations, cameras: np.ndarray, other_side: float
) -> tuple[ShadingPoints, Observations]:
    """The points with their normals on the side that most photos see, and what these see: a thin sheet shows its other side
    too, under another light, and so does any mesh to a camera that got inside."""
    towards = points.towards(observations.point, cameras[observations.photo])
    cosine = (towards * points.normal[observations.point]).sum(axis=1)
    votes = np.bincount(observations.point, np.sign(cosine), len(points))
    turn = np.where(votes < 0.0, -1.0, 1.0).astype(np.float32)
    turned = replace(points, normal=points.normal * turn[:, None])
    return turned, observations.take(cosine * turn[observations.point] > other_side)


def view(
    cache: RayCache,
    points: ShadingPoints,
    photo: int,
    point: np.ndarray,
    weights: PixelWeightSettings = USUAL,
) -> tuple[Observations, np.ndarray]:
    """All that one photo shows of the points, and of each of its samples (S,) the row.

    Args:
        point: (S,) of each sample.
    """
    part = slice(cache.starts[photo], cache.starts[photo + 1])
    visible, *shown = average_over_cells(cache, part, point, len(points), weights)
    row_of = np.zeros(len(points), np.int32)
    row_of[visible] = np.arange(len(visible))
    return Observations(visible, np.full(len(visible), photo, np.int32), *shown), row_of[point]


def _thinned_rows(
    rows: list[tuple[np.ndarray, ...]], side: int, settings: ThinningSettings
) -> tuple[np.ndarray, ...]:
    """Cells, photos and so on, of photo after photo, put together and thinned: see `thinned`."""
    whole = tuple(np.concatenate(column) for column in zip(*rows, strict=True))
    keep = thinned(whole[0], whole[1], side, settings)
    return whole if keep.all() else tuple(column[keep] for column in whole)


@njit
def _nearest_to_centres(
    cell: np.ndarray, uv: np.ndarray, side: int, nearest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The cells of which a sample lies nearer to the centre than `nearest` (count,), which is lowered; and those samples."""
    best = np.full(len(nearest), -1)
    for i in range(len(cell)):
        x, y = uv[i, 0] * np.float32(side), uv[i, 1] * np.float32(side)
        x, y = x - np.floor(x) - np.float32(0.5), y - np.floor(y) - np.float32(0.5)
        offset = x * x + y * y
        if offset < nearest[cell[i]]:
            nearest[cell[i]] = offset
            best[cell[i]] = i
    here = np.flatnonzero(best >= 0)
    return here, best[here]
