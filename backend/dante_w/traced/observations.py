"""What photos show of the shading points: mean colours, one row per photo and point, and how these are averaged and thinned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dante_w.core.color import linear_from_srgb_array
from dante_w.core.jit import njit
from dante_w.rays.ray_cache import RayCache
from dante_w.traced.pixel_weights import PixelWeightSettings


@dataclass(frozen=True)
class ThinningSettings:
    """What is kept of points that very many photos see, so that work and memory do not grow with photos.

    Attributes:
        photos: observations of a point that are kept.
        anchors: about so many cells along either side of the texture keep all, so that photos can be compared with each other.
        rows_held: observations that are held before they are thinned.
    """

    photos: int = 48
    anchors: int = 64
    rows_held: int = 1 << 22


USUAL_THINNING = ThinningSettings()


@dataclass(frozen=True)
class Observations:
    """What photos see of the points, one row per photo and point, photo after photo.

    Attributes:
        point, photo: (M,) int32.
        colour: (M, 3) float32 mean linear colour.
        pixels: (M,) int32, how many were averaged. Pixels beside an edge in depth are left out; where there are no others, this is 0
            and `colour` is theirs.
        clipped: (M,) whether any pixel was too bright for the photo.
        level: (K,) natural log of what each photo's colours were multiplied with, see `RayCache`; None: with 1.
    """

    point: np.ndarray
    photo: np.ndarray
    colour: np.ndarray
    pixels: np.ndarray
    clipped: np.ndarray
    level: np.ndarray | None = None

    def take(self, chosen: np.ndarray) -> Observations:
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


def average_over_cells(
    cache: RayCache, part: slice, cell: np.ndarray, count: int, settings: PixelWeightSettings
) -> tuple[np.ndarray, ...]:
    """What one photo shows of the cells: cells (N,) int32 in ascending order, and of each mean colour, pixels and whether it
    is clipped, as `Observations` has them.

    Args:
        part: the photo's samples. cell: (S,) of each of them, below `count`.
    """
    clear = np.ones(len(cell), bool)
    if cache.edge is not None:
        clear = np.asarray(cache.edge[part]) >= settings.near_edge
    # clear pixels, and those beside an edge: sums of linear colour, and how many
    total, clipped = np.zeros((count, 2, 4)), np.zeros((count, 2), bool)
    half = np.asarray(cache.colour[part]).view(np.uint16)
    _add_up(cell, half, *_halves(settings.clipped_from), clear, total, clipped)
    pixels = total[:, 0, 3]
    here = np.flatnonzero(pixels + total[:, 1, 3])
    kind = (pixels[here] == 0.0).astype(np.int64)
    own = total[here, kind]
    colour = np.asarray(own[:, :3] / own[:, 3:], np.float32)
    return here.astype(np.int32), colour, pixels[here].astype(np.int32), clipped[here, kind]


@lru_cache(maxsize=1)
def _halves(clipped_from: float) -> tuple[np.ndarray, np.ndarray]:
    """For each of the 65,536 halves as an sRGB-encoded value: the linear one, float32, and whether it is clipped."""
    srgb = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
    with np.errstate(invalid="ignore"):
        return linear_from_srgb_array(srgb), srgb >= clipped_from


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


def thinned(
    cell: np.ndarray,
    photo: np.ndarray,
    side: int | None = None,
    settings: ThinningSettings = USUAL_THINNING,
) -> np.ndarray:
    """(M,) bool: which observations are kept, so that there are not more with more photos.

    Of each cell `settings.photos` chosen at random, by numbers that belong to cell and photo: so what is left does not depend on
    when it is thinned. With cells of a grid of `side` x `side`, about `settings.anchors` x
    `settings.anchors` of these keep all, so that photos can be compared with each other.

    >>> keep = thinned(np.ones(100, np.int32), np.arange(100), 256)
    >>> int(keep.sum()), bool(thinned(np.zeros(100, np.int32), np.arange(100), 256).all())
    (48, True)
    """
    if len(cell) == 0 or np.bincount(cell).max() <= settings.photos:
        return np.ones(len(cell), bool)
    order = np.lexsort((_shuffled(cell, photo), cell))
    first = np.searchsorted(cell[order], cell[order])
    keep = np.empty(len(cell), bool)
    keep[order] = np.arange(len(cell)) - first < settings.photos
    if side is None:
        return keep
    apart = max(side // settings.anchors, 1)
    return keep | ((cell % side % apart == 0) & (cell // side % apart == 0))


def _shuffled(cell: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """(M,) uint32 that look random (the finaliser of MurmurHash3)."""
    x = photo.astype(np.uint32) * np.uint32(0x9E3779B1) ^ cell.astype(np.uint32) * np.uint32(0x85EBCA6B)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
    return np.asarray(x ^ (x >> np.uint32(16)))
