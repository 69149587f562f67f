"""The finest footprint of all pixels in each cell of the texture, by which pixels from afar weigh less.

A pixel from afar averages over many texels. Where closer pixels see the same place it weighs
(finest / own footprint)^2, the ratio of their areas, so that it does not blur what they show.
"""

from __future__ import annotations

import numpy as np

from dante_w.core.jit import njit_fast

#: Cells along a side of the texture: a quarter of a megabyte, as fine as 1/256 of the texture.
CELLS = 256


def no_footprints() -> np.ndarray:
    """(`CELLS`, `CELLS`) float32, infinite: no pixel has been noted yet. Row 0 is v = 0."""
    return np.full((CELLS, CELLS), np.inf, np.float32)


@njit_fast
def note_finest(uv, footprint, finest):  # type: ignore[no-untyped-def]
    """Lower `finest` (CELLS, CELLS) to the footprints (N,) float32 of pixels around texture coordinates (N, 2)."""
    for i in range(len(uv)):
        size = footprint[i]
        for y in range(_cell(uv[i, 1] - size / 2), _cell(uv[i, 1] + size / 2) + 1):
            for x in range(_cell(uv[i, 0] - size / 2), _cell(uv[i, 0] + size / 2) + 1):
                finest[y, x] = min(finest[y, x], size)


@njit_fast
def sharpness_weights(uv, footprint, finest, weight):  # type: ignore[no-untyped-def]
    """Fill in the weights (N,) in [0, 1] of samples at texture coordinates (N, 2) with footprints (N,) float32."""
    for i in range(len(uv)):
        least, size = finest[_cell(uv[i, 1]), _cell(uv[i, 0])], footprint[i]
        weight[i] = (least / size) ** 2 if least < size else 1.0


@njit_fast
def _cell(coordinate):  # type: ignore[no-untyped-def]
    return min(max(int(coordinate * CELLS), 0), CELLS - 1)
