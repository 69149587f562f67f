"""Where light is computed: one point of the surface per cell of a coarse grid over the texture.

Irradiance varies slowly over the surface, so it is solved for at some ten thousand points instead of millions
of pixels. Photos are averaged over the cells for that; the albedo itself is made from every pixel later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import prange

from dante_w.core.color import linear_from_srgb_array
from dante_w.core.jit import njit, njit_parallel
from dante_w.rays.ray_cache import RayCache, Surface, on_surface
from dante_w.traced.pixel_weights import ALL, CLIPPED, NEAR_EDGE, Weights

#: Cells along either side of the texture, at most, for most presets: no finer than the pixels of this part of the samples,
#: or photos would hardly ever show the same ones.
SIDE, SHARPEST = 256, 0.75
#: A photo sees a point's other side from this cosine down; a cell is not quite flat.
OTHER_SIDE = -0.2
#: Photos of a point that are kept where more see it; about as many cells along either side keep all.
PHOTOS, ANCHORS = 48, 64
#: Observations that are held before they are thinned.
ROWS = 1 << 22


@dataclass(frozen=True)
class ShadingPoints:
    """C points. `point_of_cell` (side * side,) int32 is -1 for cells that no photo sees; `position` (C, 3) in the
    unit cube; `normal` (C, 3) for shading, on the side that the photos see. float32."""

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
        return np.asarray(
            away / np.where(length > 0.0, length, 1.0), np.float32
        )  # a camera may be on the surface


@dataclass(frozen=True)
class Observations:
    """What photos see of the points, one row per photo and point, photo after photo: `point` and `photo` (M,)
    int32, `colour` (M, 3) mean linear colour, `pixels` (M,) how many were averaged, `clipped` (M,) whether any was
    too bright for the photo. Pixels beside an edge in depth are left out; where there are no others, `pixels` is 0 and
    `colour` theirs. `level` (K,) log of what each photo's colours were multiplied with, see `RayCache`; None: with nothing."""

    point: np.ndarray
    photo: np.ndarray
    colour: np.ndarray
    pixels: np.ndarray
    clipped: np.ndarray
    level: np.ndarray | None = None

    def of(self, chosen: np.ndarray) -> Observations:
        """The chosen rows: (M,) bool, or their numbers."""
        return Observations(
            self.point[chosen],
            self.photo[chosen],
            self.colour[chosen],
            self.pixels[chosen],
            self.clipped[chosen],
            self.level,
        )

    def levels(self, photos: int) -> np.ndarray:
        """(K,) `level` of the photos, with mean 0."""
        return np.zeros(photos) if self.level is None else self.level - self.level.mean()


def cells(uv: np.ndarray, side: int = SIDE) -> np.ndarray:
    """(N,) the grid cell of texture coordinates (N, 2)."""
    column, row = (np.clip(uv * side, 0, side - 1).astype(np.int32)).T
    return row * side + column


def _side(cache: RayCache, most: int) -> int:
    """Cells along either side of the texture that suit the photos' pixels, at `most`."""
    if cache.footprint is None or len(cache) == 0:
        return most
    wide = float(np.quantile(np.asarray(cache.footprint[:: max(len(cache) >> 17, 1)], np.float32), SHARPEST))
    return min(max(int(1.0 / wide), 1), most) if wide > 0.0 else most


def gather(
    cache: RayCache, cameras: np.ndarray, weights: Weights = ALL, finer: int = 1
) -> tuple[ShadingPoints, Observations]:
    """The shading points of a scene and what its photos see of them; of points that very many photos see, what
    `thinned` leaves.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
        finer: so many times `SIDE` cells along either side.
    """
    side = _side(cache, finer * SIDE)
    count = side * side
    nearest = np.full(count, np.inf, np.float32)  # distance of the best point so far from its cell's centre
    position, normal = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
    rows: list[tuple[np.ndarray, ...]] = []
    held = 0
    for photo in range(len(cache.starts) - 1):
        part = slice(cache.starts[photo], cache.starts[photo + 1])
        face, uv, place = located(cache, part)
        cell = cells(uv, side)
        here, best = _nearest_to_centres(cell, uv, side, nearest)
        position[here] = place[best]
        bary = np.asarray(cache.bary[part])[best]
        normal[here] = facing(cache.surface, face[best], bary, place[best], cameras[photo])
        seen_here = averaged(cache, part, cell, count, weights)
        rows.append((seen_here[0], np.full(len(seen_here[0]), photo, np.int32), *seen_here[1:]))
        held += len(seen_here[0])
        cache.forget()
        if held > 2 * ROWS:  # memory does not grow with photos
            rows = [_thinned(rows, side)]
            held = len(rows[0][0])
    cell, photo_of, colour, pixels, clipped = _thinned(rows, side)
    used = np.flatnonzero(np.isfinite(nearest))
    point_of_cell = np.full(count, -1, np.int32)
    point_of_cell[used] = np.arange(len(used))
    seen = Observations(point_of_cell[cell], photo_of, colour, pixels, clipped, cache.level)
    return _one_side(ShadingPoints(point_of_cell, position[used], normal[used]), seen, cameras)


def _one_side(
    points: ShadingPoints, seen: Observations, cameras: np.ndarray
) -> tuple[ShadingPoints, Observations]:
    """The points with their normals on the side that most photos see, and what these see: a thin sheet shows its other side
    too, under another light, and so does any mesh to a camera that got inside."""
    cosine = (points.towards(seen.point, cameras[seen.photo]) * points.normal[seen.point]).sum(axis=1)
    turn = np.where(np.bincount(seen.point, np.sign(cosine), len(points)) < 0.0, -1.0, 1.0).astype(np.float32)
    turned = replace(points, normal=points.normal * turn[:, None])
    return turned, seen.of(cosine * turn[seen.point] > OTHER_SIDE)


def located(cache: RayCache, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face (N,), texture coordinate (N, 2) and position in the unit cube (N, 3) of a run of samples."""
    face = np.array(cache.face[part])
    uv, place = np.empty((len(face), 2), np.float32), np.empty((len(face), 3), np.float32)
    corners = cache.surface.uvs.numpy(), cache.surface.positions.numpy()
    on_surface(face, np.asarray(cache.bary[part]), *corners, uv, place)
    return face, uv, place


def facing(
    surface: Surface, face: np.ndarray, bary: np.ndarray, place: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """(N, 3) float32 unit shading normals at surface points `place` (N, 3), given by face (N,) and stored weights (N, 2), on the
    side of the face that a camera at (3,) sees; zero where a face has no area."""
    normals = np.empty((0, 3, 3), np.float32) if surface.normals is None else surface.normals.numpy()
    out = np.empty((len(face), 3), np.float32)
    _face(surface.positions.numpy(), normals, face, bary, place, np.asarray(camera, np.float32), out)
    return out


def view(
    cache: RayCache, points: ShadingPoints, photo: int, point: np.ndarray, weights: Weights = ALL
) -> tuple[Observations, np.ndarray]:
    """All that one photo shows of the points, and of each of its samples (S,) the row.

    Args:
        point: (S,) of each sample.
    """
    part = slice(cache.starts[photo], cache.starts[photo + 1])
    here, *shown = averaged(cache, part, point, len(points), weights)
    row_of = np.zeros(len(points), np.int32)
    row_of[here] = np.arange(len(here))
    return Observations(here, np.full(len(here), photo, np.int32), *shown), row_of[point]


def averaged(
    cache: RayCache, part: slice, cell: np.ndarray, count: int, weights: Weights = ALL
) -> tuple[np.ndarray, ...]:
    """What one photo shows of the cells: cells (N,) int32 in ascending order, and of each mean colour, pixels and whether it
    is clipped, as `Observations` has them.

    Args:
        part: the photo's samples. cell: (S,) of each of them, below `count`.
    """
    clear = np.ones(len(cell), bool)
    if weights.edge and cache.edge is not None:
        clear = np.asarray(cache.edge[part]) >= NEAR_EDGE
    # clear pixels, and those beside an edge: sums of linear colour, and how many
    total, clipped = np.zeros((count, 2, 4)), np.zeros((count, 2), bool)
    half = np.asarray(cache.colour[part]).view(np.uint16)
    _add_up(cell, half, *_halves(), clear, total, clipped)
    pixels = total[:, 0, 3]
    here = np.flatnonzero(pixels + total[:, 1, 3])
    kind = (pixels[here] == 0.0).astype(np.int64)
    own = total[here, kind]
    colour = np.asarray(own[:, :3] / own[:, 3:], np.float32)
    return here.astype(np.int32), colour, pixels[here].astype(np.int32), clipped[here, kind]


@lru_cache(maxsize=1)
def _halves() -> tuple[np.ndarray, np.ndarray]:
    """For each of the 65,536 halves as an sRGB-encoded value: the linear one, float32, and whether it is clipped."""
    srgb = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
    with np.errstate(invalid="ignore"):
        return linear_from_srgb_array(srgb), srgb >= CLIPPED


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


@njit_parallel
def _face(
    positions: np.ndarray,
    normals: np.ndarray,
    face: np.ndarray,
    bary: np.ndarray,
    place: np.ndarray,
    camera: np.ndarray,
    out: np.ndarray,
) -> None:
    unit = np.float32(1.0 / 65535.0)
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


@njit
def _add_up(
    cell: np.ndarray,
    half: np.ndarray,
    linear: np.ndarray,
    bright: np.ndarray,
    clear: np.ndarray,
    total: np.ndarray,
    clipped: np.ndarray,
) -> None:
    for i in range(len(cell)):
        kind = 0 if clear[i] else 1
        own = total[cell[i], kind]
        for channel in range(3):
            own[channel] += linear[half[i, channel]]
            clipped[cell[i], kind] |= bright[half[i, channel]]
        own[3] += 1.0


def _thinned(rows: list[tuple[np.ndarray, ...]], side: int) -> tuple[np.ndarray, ...]:
    """Cells, photos and so on, of photo after photo, put together and thinned: see `thinned`."""
    whole = tuple(np.concatenate(column) for column in zip(*rows, strict=True))
    keep = thinned(whole[0], whole[1], side)
    return whole if keep.all() else tuple(column[keep] for column in whole)


def thinned(cell: np.ndarray, photo: np.ndarray, side: int | None = None) -> np.ndarray:
    """(M,) bool: which observations are kept, so that there are not more with more photos.

    Of each cell `PHOTOS` chosen at random, by numbers that belong to cell and photo: so what is left does not depend on
    when it is thinned. With cells of a grid of `side` x `side`, about `ANCHORS` x `ANCHORS` of these keep all, so that photos can
    be compared with each other.

    >>> keep = thinned(np.ones(100, np.int32), np.arange(100), 256)
    >>> int(keep.sum()), bool(thinned(np.zeros(100, np.int32), np.arange(100), 256).all())
    (48, True)
    """
    if len(cell) == 0 or np.bincount(cell).max() <= PHOTOS:
        return np.ones(len(cell), bool)
    order = np.lexsort((_shuffled(cell, photo), cell))
    first = np.searchsorted(cell[order], cell[order])
    keep = np.empty(len(cell), bool)
    keep[order] = np.arange(len(cell)) - first < PHOTOS
    if side is None:
        return keep
    apart = max(side // ANCHORS, 1)
    return keep | ((cell % side % apart == 0) & (cell // side % apart == 0))


def _shuffled(cell: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """(M,) uint32 that look random (the finaliser of MurmurHash3)."""
    x = photo.astype(np.uint32) * np.uint32(0x9E3779B1) ^ cell.astype(np.uint32) * np.uint32(0x85EBCA6B)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
    return np.asarray(x ^ (x >> np.uint32(16)))
