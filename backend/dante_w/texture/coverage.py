"""Which texels did the photos see, from where their pixels hit the mesh.

A pixel covers a patch of the texture, from a fraction of a texel to hundreds of texels wide. Its sample marks
cells of about that size in a pyramid of bitmaps, whose memory depends on the texture size alone (1/6 byte per
texel), however many samples come. A texel was seen if its cell is marked on any level.

What is promised. Let the hits of neighbouring pixels lie `footprint` texels apart on a square grid, at any
angle. Then no texel inside the grid is left unmarked: the cells marked for one sample span a square of at
least sqrt(2) footprints around it, the largest gap a turned grid can have. And nothing further than 2.13
footprints (1.5 cells) from a sample is marked along either axis, but for the texels that a small footprint
touches: at most one texel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dante_w.core.jit import njit


@dataclass(frozen=True)
class Coverage:
    """Bitmaps of a pyramid; make one with `empty_coverage`.

    levels[l]: (ceil(H / 2^l), ceil(ceil(W / 2^l) / 8)) uint8; cell (row, i) is bit 7 - i % 8 of byte i // 8
    and holds the texels (j, i) with j >> l and i >> l equal to it. The last level is one cell.
    """

    width: int
    height: int
    levels: tuple[np.ndarray, ...]


def empty_coverage(width: int, height: int) -> Coverage:
    """A texture of width x height texels that no photo has seen.

    Raises:
        ValueError: the texture is empty.
    """
    if width < 1 or height < 1:
        raise ValueError(f"texture of {width} x {height} texels")
    levels, w, h = [np.zeros((height, -(-width // 8)), np.uint8)], width, height
    while w > 1 or h > 1:
        w, h = (w + 1) // 2, (h + 1) // 2
        levels.append(np.zeros((h, -(-w // 8)), np.uint8))
    return Coverage(width, height, tuple(levels))


def mark(coverage: Coverage, uv: np.ndarray, footprint: np.ndarray | float) -> None:
    """Record samples of the photos, in place.

    Args:
        uv: (N, 2) texture coordinates, v up; samples that are not finite or outside [0, 1] are ignored.
        footprint: (N,) or one number: texels between this hit and those of the neighbouring samples of its photo;
            for a pixel seen at a slant its longer side. With every k-th pixel only, k times the pixel. Not finite:
            ignored.
    """
    uv = np.asarray(uv, np.float64).reshape(-1, 2)
    size = np.broadcast_to(np.asarray(footprint, np.float64), (len(uv),))
    with np.errstate(divide="ignore", invalid="ignore"):
        # A cell must be at least footprint / sqrt(2) wide; where single texels are twice that, one will do.
        level = np.ceil(np.log2(size * math.sqrt(0.5)))
    level = np.where(size > math.sqrt(0.5), level, -1.0).clip(-1, len(coverage.levels) - 1)
    good = np.isfinite(size) & (uv >= 0).all(axis=1) & (uv <= 1).all(axis=1)
    x, y = uv[good, 0] * coverage.width, (1.0 - uv[good, 1]) * coverage.height
    level = level[good].astype(np.int64)
    for fine in np.unique(level):
        members, k = level == fine, max(int(fine), 0)
        columns = (coverage.width + (1 << k) - 1) >> k
        _mark(coverage.levels[k], columns, x[members] / 2.0**k, y[members] / 2.0**k, bool(fine < 0))


def seen_texels(coverage: Coverage, rows: tuple[int, int] | None = None) -> np.ndarray:
    """(r1 - r0, W) bool: which texels of rows r0 <= j < r1 (default: all) the samples saw; row 0 is the top row.

    Raises:
        ValueError: rows that the texture does not have.
    """
    r0, r1 = rows or (0, coverage.height)
    if not 0 <= r0 <= r1 <= coverage.height:
        raise ValueError(f"rows {rows} of a texture of {coverage.height} rows")
    coarse = np.zeros((1, 1), bool)
    if r0 == r1:
        return np.zeros((0, coverage.width), bool)
    above = 0  # the first row of the level before this one that is in `coarse`
    for level in range(len(coverage.levels) - 1, -1, -1):
        first, last = r0 >> level, (r1 - 1) >> level
        columns = (coverage.width + (1 << level) - 1) >> level
        fine = np.unpackbits(coverage.levels[level][first : last + 1], axis=1, count=columns).view(bool)
        _spread(coarse, above, fine, first)
        coarse, above = fine, first
    return coarse


@njit
def _mark(bits: np.ndarray, columns: int, x: np.ndarray, y: np.ndarray, single: bool) -> None:
    """Set the cell that holds each (x, y), in cells, or the 2 x 2 cells nearest to it."""
    rows = bits.shape[0]
    for n in range(len(x)):
        if single:
            i, j = min(int(x[n]), columns - 1), min(int(y[n]), rows - 1)
            bits[j, i >> 3] |= np.uint8(128 >> (i & 7))
            continue
        left, top = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        for j in range(max(top, 0), min(top + 2, rows)):
            for i in range(max(left, 0), min(left + 2, columns)):
                bits[j, i >> 3] |= np.uint8(128 >> (i & 7))


@njit
def _spread(coarse: np.ndarray, above: int, fine: np.ndarray, first: int) -> None:
    """Mark the cells of fine (whose row 0 is row `first` of its level) whose parent in coarse is marked."""
    for j in range(fine.shape[0]):
        parent = ((first + j) >> 1) - above
        if parent < coarse.shape[0]:
            for i in range(fine.shape[1]):
                fine[j, i] |= coarse[parent, i >> 1]
