"""Smooth filling of the texels nobody knows: push-pull, with memory fixed whatever the texture's size.

Pull: a cell of level l holds the mean of the known texels among its 2^l x 2^l. Push: a cell without any is interpolated
bilinearly from the level above. The levels of at most 1024 cells a side are kept whole, summed up as known texels
stream in; the finer ones are made again for each band of rows from its own texels, with the same result.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dante_w.jit import njit

LARGEST_KEPT = 1024
NOTHING_KNOWN = 0.5  # linear grey, when not one texel is known


@dataclass
class Pyramid:
    """Make one with `empty`; `add` every known texel, `solve`, then `fill` band by band.

    level: the finest level kept. total: (h, w, 4) float32 sums of colour and count there. solved: levels `level`,
    level + 1, ..., each (h, w, 3) float32.
    """

    width: int
    height: int
    level: int
    total: np.ndarray
    solved: list[np.ndarray] = field(default_factory=list)

    def add(self, row: np.ndarray, column: np.ndarray, colour: np.ndarray) -> None:
        """Known texels: (N,) rows and columns, (N, 3) float32 linear colours."""
        _scatter(self.total, row >> self.level, column >> self.level, colour)

    def solve(self) -> None:
        """Fill the levels kept; no `add` after this."""
        totals = [self.total]
        while max(totals[-1].shape[:2]) > 1:
            totals.append(_halve(totals[-1], 0))
        grey = np.full((1, 1, 3), NOTHING_KNOWN, np.float32)
        solved = [_push(totals.pop(), 0, grey, 0)]
        while totals:
            solved.append(_push(totals.pop(), 0, solved[-1], 0))
        self.solved = solved[::-1]
        self.total = self.total[:0]

    def needs(self, rows: tuple[int, int]) -> tuple[int, int]:
        """The rows of texels that `fill` wants for a band: whole cells of the finest level kept, one more each way."""
        cell = 1 << self.level
        first, last = rows[0] // cell * cell - cell, -(-rows[1] // cell) * cell + cell
        # Interpolation reads one cell beyond, on every level between: less than one kept cell in all.
        return (max(first, 0), min(last, self.height)) if self.level else rows

    def fill(self, rows: tuple[int, int], colour: np.ndarray, known: np.ndarray) -> np.ndarray:
        """(r1 - r0, W, 3) float32: rows r0 <= j < r1 with the unknown texels filled.

        colour: (n, W, 3) float32 and known: (n, W) bool for the rows `needs(rows)`; colour counts where known.
        """
        first = self.needs(rows)[0]
        totals = [
            np.concatenate(
                [np.where(known[..., None], colour, 0), known[..., None]], axis=2, dtype=np.float32
            )
        ]
        for level in range(1, self.level):
            totals.append(_halve(totals[-1], (first >> (level - 1)) & 1))
        if self.level == 0:
            return self.solved[0][rows[0] : rows[1]]
        finer, top = self.solved[0], 0
        for level in range(self.level - 1, -1, -1):
            finer, top = _push(totals.pop(), first >> level, finer, top), first >> level
        return finer[rows[0] - first : rows[1] - first]


def empty(width: int, height: int) -> Pyramid:
    """A pyramid for a texture of width x height texels, none known."""
    level = 0
    while max(width, height) > LARGEST_KEPT << level:
        level += 1
    cell = 1 << level
    return Pyramid(width, height, level, np.zeros((-(-height // cell), -(-width // cell), 4), np.float32))


@njit
def _scatter(total: np.ndarray, row: np.ndarray, column: np.ndarray, colour: np.ndarray) -> None:
    for n in range(len(row)):
        cell = total[row[n], column[n]]
        for c in range(3):
            cell[c] += colour[n, c]
        cell[3] += 1


@njit
def _halve(total: np.ndarray, odd: int) -> np.ndarray:
    """Sums of 2 x 2 cells; the first row of total is the lower one of its pair if odd."""
    rows, columns = total.shape[0], total.shape[1]
    coarse = np.zeros(((rows + odd + 1) // 2, (columns + 1) // 2, 4), np.float32)
    for j in range(rows):
        for i in range(columns):
            for c in range(4):
                coarse[(j + odd) // 2, i // 2, c] += total[j, i, c]
    return coarse


@njit
def _push(total: np.ndarray, first: int, coarse: np.ndarray, above: int) -> np.ndarray:
    """Means of the cells with a count, the others interpolated from the level above.

    Row 0 of total is row `first` of its level, row 0 of coarse row `above` of its; beyond coarse its edge continues.
    """
    rows, columns = total.shape[0], total.shape[1]
    out = np.empty((rows, columns, 3), np.float32)
    last_row, last_column = coarse.shape[0] - 1, coarse.shape[1] - 1
    for j in range(rows):
        near_row = min((first + j) // 2 - above, last_row)
        far_row = min(max(near_row + (1 if (first + j) % 2 else -1), 0), last_row)
        for i in range(columns):
            if total[j, i, 3] > 0:
                for c in range(3):
                    out[j, i, c] = total[j, i, c] / total[j, i, 3]
                continue
            near = min(i // 2, last_column)
            far = min(max(near + (1 if i % 2 else -1), 0), last_column)
            for c in range(3):
                out[j, i, c] = np.float32(0.75) * (
                    np.float32(0.75) * coarse[near_row, near, c] + np.float32(0.25) * coarse[near_row, far, c]
                ) + np.float32(0.25) * (
                    np.float32(0.75) * coarse[far_row, near, c] + np.float32(0.25) * coarse[far_row, far, c]
                )
    return out
