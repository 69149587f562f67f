"""Push-pull: a smooth colour for every cell of a pyramid that has none of its own (Gortler et al., "The lumigraph", 1996).

Pull, from fine to coarse: a cell without weight of its own gets the sums of weighted colour and weight of the 2 x 2 cells
in it. Push, from coarse to fine: a cell with weight gets colour / weight, and one without is interpolated bilinearly from
the coarser level. Colours are linear.

Levels are float32 (rows, columns, 4), colour x weight and weight; a level has half as many rows and columns, rounded up.
The kernels call each other, so they lie in one file: numba compares no other when it decides whether cached code is stale.
"""

from __future__ import annotations

import numpy as np

from dante_w.core.jit import njit


@njit
def pull(fine: np.ndarray, coarse: np.ndarray) -> None:
    """Sum up the cells of `fine` in each cell of `coarse` that has no weight of its own."""
    for j in range(coarse.shape[0]):
        for i in range(coarse.shape[1]):
            if coarse[j, i, 3] > 0:
                continue
            for b in range(2 * j, min(2 * j + 2, fine.shape[0])):
                for a in range(2 * i, min(2 * i + 2, fine.shape[1])):
                    for c in range(4):
                        coarse[j, i, c] += fine[b, a, c]


@njit
def pull_known(colour: np.ndarray, known: np.ndarray, coarse: np.ndarray) -> None:
    """The same for texels (H, W, 3) of weight 1 where `known` (H, W) and 0 elsewhere, where `coarse` is empty."""
    for j in range(known.shape[0]):
        for i in range(known.shape[1]):
            if known[j, i]:
                for c in range(3):
                    coarse[j // 2, i // 2, c] += colour[j, i, c]
                coarse[j // 2, i // 2, 3] += 1


@njit
def push(total: np.ndarray, first: int, coarse: np.ndarray, coarse_first: int, out: np.ndarray) -> None:
    """Colours (h, w, 3 or more) `out`, which may be `total` itself, of the cells of `total`, and of `coarse` above.

    Row 0 of `total` is row `first` of its level; row 0 of `coarse`, colours, is row `coarse_first` of its.
    """
    for j in range(total.shape[0]):
        for i in range(total.shape[1]):
            weight = total[j, i, 3]
            if weight > 0:
                for c in range(3):
                    out[j, i, c] = total[j, i, c] / weight
            else:
                _interpolate(coarse, coarse_first, first + j, i, out[j, i])


@njit
def interpolate_at(
    coarse: np.ndarray, coarse_first: int, row: np.ndarray, column: np.ndarray, out: np.ndarray
) -> None:
    """Colours (N, 3) `out` of the cells at (row, column) of the level below `coarse`, which begins at its row `coarse_first`."""
    for n in range(len(row)):
        _interpolate(coarse, coarse_first, row[n], column[n], out[n])


@njit
def _interpolate(coarse: np.ndarray, coarse_first: int, j: int, i: int, out: np.ndarray) -> None:
    """Bilinear value of the level above at the centre of cell (j, i); beyond `coarse` its edge continues."""
    last_row, last_column = coarse.shape[0] - 1, coarse.shape[1] - 1
    row, column = min(j // 2 - coarse_first, last_row), min(i // 2, last_column)
    other_row = min(max(row + (1 if j % 2 else -1), 0), last_row)
    other = min(max(column + (1 if i % 2 else -1), 0), last_column)
    for c in range(3):
        near = np.float32(0.75) * coarse[row, column, c] + np.float32(0.25) * coarse[row, other, c]
        far = np.float32(0.75) * coarse[other_row, column, c] + np.float32(0.25) * coarse[other_row, other, c]
        out[c] = np.float32(0.75) * near + np.float32(0.25) * far


@njit
def scatter(total: np.ndarray, row: np.ndarray, column: np.ndarray, colour: np.ndarray) -> None:
    """Add colours (N, 3) of weight 1 to the cells at (row, column)."""
    for n in range(len(row)):
        cell = total[row[n], column[n]]
        for c in range(3):
            cell[c] += colour[n, c]
        cell[3] += 1
