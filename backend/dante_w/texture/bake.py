"""From a function of texture coordinates to the texels of a texture, in bands of rows of fixed memory.

Four passes over the bands, all in place in the arrays (or memory maps) given, so a 16384^2 texture is never
in memory:

1. texels on the mesh that photos saw get the albedo at their centre; border texels, just outside a chart, that
   a bilinear lookup inside it may read get the albedo of the chart's nearest point, so no chart ever borrows
   from another;
2. every other texel is filled smoothly from the seen ones (push-pull), so that mipmaps never bleed black;
3. the gutter: texels near a chart, outside it, take over the nearest texel of a chart;
4. border texels are marked as outside in the coverage.

Filling is done on linear colour. The result does not depend on the height of the bands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dante_w.core.jit import njit
from dante_w.texture.coverage import Coverage, seen_texels
from dante_w.texture.encoding import decode_rows, encode_rows
from dante_w.texture.pyramid_fill import Pyramid, empty_pyramid
from dante_w.texture.rasterise import Bins, bin_faces, rasterise_bins, rasterise_border

#: Values of coverage.png; BORDER only while baking.
OUTSIDE, BORDER, FILLED, SEEN = 0, 64, 128, 255


@dataclass(frozen=True)
class BakeSettings:
    """How far charts are continued, and how much of the texture is in memory at a time."""

    #: Texels beyond each chart that take its colour: mipmaps and bilinear lookups do not bleed.
    gutter: int = 16
    #: Texels of a band of rows; no result depends on it.
    band_texels: int = 1 << 20
    #: Texels whose colours are computed at once.
    chunk_texels: int = 1 << 18
    #: Cells a side of the largest level of the filling's pyramid that is kept whole.
    largest_kept: int = 1024


BAKE = BakeSettings()

#: (N, 2) float64 texture coordinates, v up -> (N, 3) linear albedo.
Texels = Callable[[np.ndarray], np.ndarray]


def bake(
    texels: Texels,
    uvs: np.ndarray,
    coverage: Coverage,
    out: np.ndarray,
    coverage_out: np.ndarray,
    progress: Callable[[float], None] = lambda fraction: None,
    settings: BakeSettings = BAKE,
) -> float:
    """Bake a texture.

    Args:
        texels: called with `chunk_texels` places at most, and only with places that photos saw. Colours that are not
            finite count as not seen.
        uvs: (F, 3, 2) UV triangles.
        coverage: what the photos saw, of the texture's size.
        out: (H, W, 3) to write: uint8 or uint16 (sRGB) or float16 or float32 (linear); row 0 is the top row.
        coverage_out: (H, W) uint8 to write: 255 seen, 128 on the mesh but filled, 0 outside every chart.
        progress: called after each band with the fraction done; whatever it raises ends the bake.

    Returns:
        The fraction of the texels on the mesh that were seen; 0 when there are none.

    Raises:
        ValueError: the sizes disagree, or the dtype of out is none of the four.
    """
    height, width = coverage.height, coverage.width
    if (
        out.shape != (height, width, 3)
        or coverage_out.shape != (height, width)
        or coverage_out.dtype != np.uint8
    ):
        raise ValueError(
            f"textures {out.shape}, {coverage_out.shape} {coverage_out.dtype} for {width} x {height}"
        )
    encode_rows(np.zeros((1, 3), np.float32), out.dtype)
    bins = bin_faces(uvs, width, height)
    step = max(1, settings.band_texels // width)
    bands = [(r0, min(r0 + step, height)) for r0 in range(0, height, step)]
    pyramid = empty_pyramid(width, height, settings.largest_kept)
    on_mesh = on_photos = 0
    for n, rows in enumerate(bands):
        marks = _evaluate_band(texels, bins, coverage, rows, out, pyramid, settings.chunk_texels)
        coverage_out[rows[0] : rows[1]] = marks
        on_mesh += int(np.count_nonzero(marks >= FILLED))
        on_photos += int(np.count_nonzero(marks == SEEN))
        progress((n + 1) / len(bands) * 0.7)
    pyramid.solve()
    for n, rows in enumerate(bands):
        _fill_band(pyramid, rows, out, coverage_out, settings.band_texels // 2)
        progress(0.7 + (n + 1) / len(bands) * 0.2)
    for n, rows in enumerate(bands):
        _gutter_band(rows, settings.gutter, out, coverage_out)
        progress(0.9 + (n + 1) / len(bands) * 0.09)
    for r0, r1 in bands:
        marks = coverage_out[r0:r1]
        marks[marks == BORDER] = OUTSIDE
    progress(1.0)
    return on_photos / on_mesh if on_mesh else 0.0


def _evaluate_band(
    texels: Texels,
    bins: Bins,
    coverage: Coverage,
    rows: tuple[int, int],
    out: np.ndarray,
    pyramid: Pyramid,
    chunk: int,
) -> np.ndarray:
    """Pass 1: colours of a band's seen texels, which also go into the pyramid; returns its marks."""
    r0, r1 = rows
    width, height = bins.width, bins.height
    owner = rasterise_bins(bins, rows)
    above, below = max(r0 - 2, 0), min(r1 + 2, height)
    band_seen = seen_texels(coverage, (above, below))
    marks = np.where(owner < 0, OUTSIDE, FILLED).astype(np.uint8).reshape(-1)

    def paint(index: np.ndarray, uv: np.ndarray, mark: int) -> None:
        """Put the colours at uv into the band's texels of these flat indices."""
        colour = np.asarray(texels(uv), np.float32)
        finite = np.isfinite(colour).all(axis=1)
        colour, index = colour[finite], index[finite]
        row, column = np.divmod(index, width)
        out[row + r0, column] = encode_rows(colour, out.dtype)
        marks[index] = mark
        if mark == SEEN:
            pyramid.add(row + r0, column, colour)

    inside = np.flatnonzero((owner >= 0) & band_seen[r0 - above : r1 - above])
    for start in range(0, len(inside), chunk):
        index = inside[start : start + chunk]
        row, column = np.divmod(index, width)
        uv = np.stack([(column + 0.5) / width, 1.0 - (row + r0 + 0.5) / height], axis=1)
        paint(index, uv, SEEN)
    border, border_uv = rasterise_border(bins, rows, owner)
    # A border texel was seen if the texel that holds the chart's nearest point was.
    column = (border_uv[:, 0] * width).astype(np.int64).clip(0, width - 1)
    row = ((1.0 - border_uv[:, 1]) * height).astype(np.int64).clip(above, below - 1)
    border_seen = band_seen[row - above, column]
    border, border_uv = border[border_seen], border_uv[border_seen]
    for start in range(0, len(border), chunk):
        part = slice(start, start + chunk)
        paint(border[part], border_uv[part], BORDER)
    return marks.reshape(owner.shape)


def _fill_band(
    pyramid: Pyramid, rows: tuple[int, int], out: np.ndarray, marks: np.ndarray, texels: int
) -> None:
    """Pass 2: push-pull into what is neither seen nor border, about so many texels at a time."""
    step = max(1, texels // out.shape[1])
    for r0 in range(*rows, step):
        part = (r0, min(r0 + step, rows[1]))
        first, last = pyramid.needs(part)
        seen_near = np.asarray(marks[first:last]) == SEEN
        part_marks = np.asarray(marks[part[0] : part[1]])
        row, column = np.nonzero((part_marks != SEEN) & (part_marks != BORDER))
        row += r0
        colour = decode_rows(np.asarray(out[first:last]))
        out[row, column] = encode_rows(pyramid.fill(part, colour, seen_near, row, column), out.dtype)


def _gutter_band(rows: tuple[int, int], gutter: int, out: np.ndarray, marks: np.ndarray) -> None:
    """Pass 3: texels within the gutter take the colour of the nearest texel of a chart."""
    if gutter < 1:
        return
    r0, r1 = rows
    first, last = max(r0 - gutter, 0), min(r1 + gutter, marks.shape[0])
    source = _nearest(np.asarray(marks[first:last]), r0 - first, r1 - first, gutter)
    row, column = np.nonzero(source >= 0)
    from_row, from_column = np.divmod(source[row, column], marks.shape[1])
    out[row + r0, column] = out[from_row + first, from_column]


@njit
def _nearest(marks: np.ndarray, top: int, bottom: int, gutter: int) -> np.ndarray:
    """For rows top..bottom-1: flat index of the nearest mark nearer than gutter + 1; -1 if none or marked.

    Ties: the nearer column, the left one, the upper row. By hand for these: scipy, which is no dependency of the backend,
    promises none.
    """
    rows, width = marks.shape
    limit = gutter + 1
    # signed rows to the nearest marked texel of the column
    near = np.full((bottom - top, width), limit, np.int32)
    for i in range(width):
        since = limit
        for j in range(rows):
            since = 0 if marks[j, i] > 0 else since + 1
            if top <= j < bottom and since < limit:
                near[j - top, i] = -since
        since = limit
        for j in range(rows - 1, -1, -1):
            since = 0 if marks[j, i] > 0 else since + 1
            if top <= j < bottom and since < abs(near[j - top, i]):
                near[j - top, i] = since
    source = np.full((bottom - top, width), -1, np.int64)
    for j in range(bottom - top):
        for i in range(width):
            if near[j, i] == 0:
                continue
            best = limit * limit
            for reach in range(limit):
                if reach * reach >= best:
                    break
                for side in range(-1, 2, 2):
                    k = i + side * reach
                    if 0 <= k < width:
                        distance = reach * reach + near[j, k] * near[j, k]
                        if distance < best:
                            best = distance
                            source[j, i] = (j + top + near[j, k]) * width + k
    return source
