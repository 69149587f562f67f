"""Which face covers which texel: an exact rasteriser of UV triangles.

Texel (column i, row j) of a W x H texture has its centre at u = (i + 0.5) / W, v = 1 - (j + 0.5) / H.
Corners are snapped to 1/16384 texel and everything after that is integer arithmetic, so two triangles that
share an edge or a corner never both claim, and never both miss, a texel centre on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dante_w.core.jit import njit

#: Texels along a side: keeps the products of two fixed-point lengths inside 63 bits.
LARGEST = 32768
#: One texel in fixed point.
_ONE = 1 << 14
_HALF = _ONE // 2
#: Rows of a band of `Bins`.
_BIN_ROWS = 64


@dataclass(frozen=True)
class Bins:
    """UV triangles in fixed point, sorted into bands of rows, for one texture size.

    points: (F, 3, 2) int32, x right and y down, in 1/16384 texel. first: (B + 1,) int64 and faces:
    (first[-1],) int32: band b, rows 64 b to 64 b + 63, is touched by faces[first[b]:first[b + 1]], ascending.
    """

    width: int
    height: int
    points: np.ndarray
    first: np.ndarray
    faces: np.ndarray


def bin_faces(uvs: np.ndarray, width: int, height: int) -> Bins:
    """Prepare UV triangles for `rasterise_bins`, `rasterise_border` and `count_bins`.

    Args:
        uvs: (F, 3, 2) float. Triangles with a corner that is not finite or lies outside [-1, 2] are left out.

    Raises:
        ValueError: a size outside 1..32768.
    """
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise ValueError(f"texture of {width} x {height} texels: each side must be 1 to {LARGEST}")
    uvs = np.asarray(uvs, np.float64).reshape(-1, 3, 2)
    usable = np.logical_and.reduce((uvs >= -1) & (uvs <= 2), axis=(1, 2))  # false for NaN
    scaled = np.where(usable[:, None, None], uvs, 0.0)
    scaled[..., 1] = 1.0 - scaled[..., 1]
    scaled *= (width * _ONE, height * _ONE)
    points = np.rint(scaled).astype(np.int32)
    # A triangle is listed two rows beyond its own, so that the same bins serve the border as well.
    low = (points[..., 1].min(axis=1).astype(np.int64) // _ONE - 2).clip(0, height) // _BIN_ROWS
    high = (points[..., 1].max(axis=1).astype(np.int64) // _ONE + 2).clip(-1, height - 1) // _BIN_ROWS
    high[~usable] = -1
    bands = (height - 1) // _BIN_ROWS + 1
    first, faces = _bin(low, high, bands)
    return Bins(width, height, points, first, faces)


def rasterise(uvs: np.ndarray, width: int, height: int, rows: tuple[int, int] | None = None) -> np.ndarray:
    """(r1 - r0, W) int32: the face whose UV triangle (uvs: (F, 3, 2)) holds each texel centre of the rows.

    -1 where there is none; the lowest face where triangles overlap; a centre on an edge belongs to the
    triangle whose top or left edge that is. For many bands of one texture call `bin_faces` once and
    `rasterise_bins` for each.
    """
    return rasterise_bins(bin_faces(uvs, width, height), rows or (0, height))


def rasterise_bins(bins: Bins, rows: tuple[int, int]) -> np.ndarray:
    """`rasterise` for faces already binned; costs time in proportion to the faces that touch the rows."""
    owner = np.full((rows[1] - rows[0], bins.width), -1, np.int32)
    for faces, low, high in _bands(bins, rows):
        _fill(bins.points, faces, low, high, rows[0], 0.0, False, owner)
    return owner


def rasterise_border(bins: Bins, rows: tuple[int, int], owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Texels that no triangle owns but that a bilinear lookup inside a triangle may read.

    Args:
        owner: `rasterise_bins(bins, rows)`.

    Returns:
        Flat indices (N,) int64 into owner, ascending, and uv (N, 2) float64: the nearest point of the nearest triangle, at
        most sqrt(2) texels away.
    """
    reach = math.sqrt(2.0) * (1 + 1e-9)
    # squared distance to the nearest point, then the offset to it, in texels
    nearest = np.full((*owner.shape, 3), np.inf, np.float32)
    for faces, low, high in _bands(bins, rows):
        _border(bins.points, faces, low, high, rows[0], reach, owner, nearest)
    index = np.flatnonzero(nearest[..., 0] <= reach * reach)
    offset = nearest.reshape(-1, 3)[index, 1:].astype(np.float64)
    row, column = np.divmod(index, bins.width)
    u = (column + 0.5 + offset[:, 0]) / bins.width
    v = 1.0 - (row + rows[0] + 0.5 + offset[:, 1]) / bins.height
    return index, np.stack([u, v], axis=1)


def count_bins(bins: Bins, rows: tuple[int, int], margin: float) -> np.ndarray:
    """(r1 - r0, W) int32: how many triangles hold each texel centre of the rows well inside: at least `margin` texels, or a
    quarter of the triangle's inscribed circle if that is less, from every edge."""
    count = np.zeros((rows[1] - rows[0], bins.width), np.int32)
    for faces, low, high in _bands(bins, rows):
        _fill(bins.points, faces, low, high, rows[0], margin, True, count)
    return count


def _bands(bins: Bins, rows: tuple[int, int]) -> list[tuple[np.ndarray, int, int]]:
    """The faces of each bin that meets `rows`, with the rows of `rows` that lie in it."""
    if not 0 <= rows[0] <= rows[1] <= bins.height:
        raise ValueError(f"rows {rows} of a texture of {bins.height} rows")
    return [
        (
            bins.faces[bins.first[b] : bins.first[b + 1]],
            max(rows[0], b * _BIN_ROWS),
            min(rows[1], (b + 1) * _BIN_ROWS),
        )
        for b in range(rows[0] // _BIN_ROWS, -(-rows[1] // _BIN_ROWS))
    ]


@njit
def _bin(low: np.ndarray, high: np.ndarray, bands: int) -> tuple[np.ndarray, np.ndarray]:
    first = np.zeros(bands + 1, np.int64)
    for f in range(len(low)):
        for b in range(low[f], high[f] + 1):
            first[b + 1] += 1
    for b in range(bands):
        first[b + 1] += first[b]
    faces = np.empty(first[bands], np.int32)
    place = first[:-1].copy()
    for f in range(len(low)):
        for b in range(low[f], high[f] + 1):
            faces[place[b]] = f
            place[b] += 1
    return first, faces


@njit
def _edges(points: np.ndarray, f: int, margin: float, edges: np.ndarray) -> bool:
    """Edge k of face f as (dx, dy, ax, ay, least): inside is where dx (y - ay) - dy (x - ax) >= least.

    margin 0: the top-left rule; positive: that many texels inside; negative: outside. False if f has no area.
    """
    ax, ay = np.int64(points[f, 0, 0]), np.int64(points[f, 0, 1])
    bx, by = np.int64(points[f, 1, 0]), np.int64(points[f, 1, 1])
    cx, cy = np.int64(points[f, 2, 0]), np.int64(points[f, 2, 1])
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0:
        return False
    if area < 0:
        bx, by, cx, cy = cx, cy, bx, by
    edges[0, 0], edges[0, 1], edges[0, 2], edges[0, 3] = bx - ax, by - ay, ax, ay
    edges[1, 0], edges[1, 1], edges[1, 2], edges[1, 3] = cx - bx, cy - by, bx, by
    edges[2, 0], edges[2, 1], edges[2, 2], edges[2, 3] = ax - cx, ay - cy, cx, cy
    round_trip = 0.0
    for k in range(3):
        round_trip += math.hypot(edges[k, 0], edges[k, 1])
    inset = min(margin * _ONE, 0.25 * abs(area) / round_trip)
    for k in range(3):
        dx, dy = edges[k, 0], edges[k, 1]
        if margin == 0.0:
            edges[k, 4] = 0 if dy < 0 or (dy == 0 and dx > 0) else 1
        else:
            edges[k, 4] = np.int64(math.ceil(inset * math.hypot(dx, dy)))
    return True


@njit
def _span(edges: np.ndarray, j: int, low: int, high: int) -> tuple[int, int]:
    """First and last column of row j inside the edges and low..high; last < first if there is none."""
    for k in range(3):
        dx, dy = edges[k, 0], edges[k, 1]
        # Along the row the edge function is value - dy _ONE i; all integers, so the divisions round exactly.
        value = dx * (j * _ONE + _HALF - edges[k, 3]) - dy * (_HALF - edges[k, 2]) - edges[k, 4]
        if dy < 0:
            low = max(low, -(value // (-dy * _ONE)))
        elif dy > 0:
            high = min(high, value // (dy * _ONE))
        elif value < 0:
            return 0, -1
    return low, high


@njit
def _fill(
    points: np.ndarray,
    faces: np.ndarray,
    low: int,
    high: int,
    top: int,
    margin: float,
    counting: bool,
    out: np.ndarray,
) -> None:
    """Rows low..high-1 of out (whose row 0 is texture row `top`): the first face's id, or how many faces."""
    edges = np.empty((3, 5), np.int64)
    for f in faces:
        if not _edges(points, f, margin, edges):
            continue
        least = min(edges[0, 3], edges[1, 3], edges[2, 3])
        most = max(edges[0, 3], edges[1, 3], edges[2, 3])
        for j in range(max(low, (least - _HALF) // _ONE), min(high, (most - _HALF) // _ONE + 1)):
            begin, end = _span(edges, j, 0, out.shape[1] - 1)
            for i in range(begin, end + 1):
                if counting:
                    out[j - top, i] += 1
                elif out[j - top, i] < 0:
                    out[j - top, i] = f


@njit
def _border(
    points: np.ndarray,
    faces: np.ndarray,
    low: int,
    high: int,
    top: int,
    reach: float,
    owner: np.ndarray,
    nearest: np.ndarray,
) -> None:
    """Nearest point of the nearest face, for texels without owner: nearest = (d^2, dx, dy)."""
    edges = np.empty((3, 5), np.int64)
    for f in faces:
        if not _edges(points, f, -reach, edges):
            continue
        least = min(edges[0, 3], edges[1, 3], edges[2, 3])
        most = max(edges[0, 3], edges[1, 3], edges[2, 3])
        left = max(0, min(edges[0, 2], edges[1, 2], edges[2, 2]) // _ONE - 2)
        right = min(owner.shape[1] - 1, max(edges[0, 2], edges[1, 2], edges[2, 2]) // _ONE + 2)
        for j in range(max(low, least // _ONE - 2), min(high, most // _ONE + 3)):
            begin, end = _span(edges, j, left, right)
            for i in range(begin, end + 1):
                if owner[j - top, i] >= 0:
                    continue
                # The centre is outside this face too, so the nearest point is on one of its edges.
                for k in range(3):
                    dx, dy = edges[k, 0] / _ONE, edges[k, 1] / _ONE
                    px, py = i + 0.5 - edges[k, 2] / _ONE, j + 0.5 - edges[k, 3] / _ONE
                    along = min(max((px * dx + py * dy) / max(dx * dx + dy * dy, 1e-30), 0.0), 1.0)
                    x, y = px - along * dx, py - along * dy
                    if x * x + y * y < nearest[j - top, i, 0]:
                        nearest[j - top, i, 0] = x * x + y * y
                        nearest[j - top, i, 1] = -x
                        nearest[j - top, i, 2] = -y
