"""Smooth filling of the texels nobody knows: push-pull, with memory fixed whatever the texture's size.

Pull: a cell of level l holds the mean of the known texels among its 2^l x 2^l. Push: a cell without any is
interpolated bilinearly from the level above. The levels of at most 1024 cells a side are kept whole, summed
up as known texels stream in; the finer ones are made again for each band of rows from its own texels, with
the same result.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dante_w.core.jit import njit

LARGEST_KEPT = 1024
NOTHING_KNOWN = 0.5  # linear grey, when not one texel is known


@dataclass
class Pyramid:
    """Make one with `empty`; `add` every known texel, `solve`, then `fill` band by band.

    level: the finest level kept. total: (h, w, 4) float32 sums of colour and count there. solved: levels
    `level`, level + 1, ..., each (h, w, 3) float32.
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
            totals.append(_halve(totals[-1]))
        grey = np.full((1, 1, 3), NOTHING_KNOWN, np.float32)
        solved = [_push(totals.pop(), 0, grey, 0)]
        while totals:
            solved.append(_push(totals.pop(), 0, solved[-1], 0))
        self.solved = solved[::-1]
        self.total = self.total[:0]

    def needs(self, rows: tuple[int, int]) -> tuple[int, int]:
        """The rows that `fill` wants for a band: whole cells of the finest level kept, one more each way."""
        cell = 1 << self.level
        first, last = rows[0] // cell * cell - cell, -(-rows[1] // cell) * cell + cell
        # Interpolation reads one cell beyond, on every level between: less than one kept cell in all.
        return (max(first, 0), min(last, self.height)) if self.level else rows

    def fill(
        self,
        rows: tuple[int, int],
        colour: np.ndarray,
        known: np.ndarray,
        row: np.ndarray,
        column: np.ndarray,
    ) -> np.ndarray:
        """(N, 3) float32: colours for the unknown texels at (row, column), int64 (N,), of rows r0..r1-1.

        colour: (n, W, 3) float32 and known: (n, W) bool for the rows `needs(rows)`; colour is read where known.
        """
        if self.level == 0:
            return self.solved[0][row, column]
        first = self.needs(rows)[
            0
        ]  # a multiple of 2^level, so that pairs of rows start at its row on every level
        totals: list[np.ndarray] = []
        for _ in range(1, self.level):
            totals.append(_halve(totals[-1]) if totals else _halve_known(colour, known))
        finer, top = self.solved[0], 0
        for level in range(self.level - 1, 0, -1):
            finer, top = _push(totals.pop(), first >> level, finer, top), first >> level
        return _at(finer, top, row, column)


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
def _halve(total: np.ndarray) -> np.ndarray:
    """Sums of 2 x 2 cells."""
    rows, columns = total.shape[0], total.shape[1]
    coarse = np.zeros(((rows + 1) // 2, (columns + 1) // 2, 4), np.float32)
    for j in range(rows):
        for i in range(columns):
            for c in range(4):
                coarse[j // 2, i // 2, c] += total[j, i, c]
    return coarse


@njit
def _halve_known(colour: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Sums of colour and count of the known texels of 2 x 2."""
    rows, columns = known.shape
    coarse = np.zeros(((rows + 1) // 2, (columns + 1) // 2, 4), np.float32)
    for j in range(rows):
        for i in range(columns):
            if known[j, i]:
                for c in range(3):
                    coarse[j // 2, i // 2, c] += colour[j, i, c]
                coarse[j // 2, i // 2, 3] += 1
    return coarse


@njit
def _between(coarse: np.ndarray, above: int, j: int, i: int, out: np.ndarray) -> None:
    """Bilinear value of the level above at the centre of cell (j, i); beyond coarse its edge continues."""
    last_row, last_column = coarse.shape[0] - 1, coarse.shape[1] - 1
    row, column = min(j // 2 - above, last_row), min(i // 2, last_column)
    other_row = min(max(row + (1 if j % 2 else -1), 0), last_row)
    other = min(max(column + (1 if i % 2 else -1), 0), last_column)
    for c in range(3):
        near = np.float32(0.75) * coarse[row, column, c] + np.float32(0.25) * coarse[row, other, c]
        far = np.float32(0.75) * coarse[other_row, column, c] + np.float32(0.25) * coarse[other_row, other, c]
        out[c] = np.float32(0.75) * near + np.float32(0.25) * far


@njit
def _push(total: np.ndarray, first: int, coarse: np.ndarray, above: int) -> np.ndarray:
    """Means of the cells with a count, the others from the level above.

    Row 0 of total is row `first` of its level, row 0 of coarse row `above` of its.
    """
    out = np.empty((total.shape[0], total.shape[1], 3), np.float32)
    for j in range(total.shape[0]):
        for i in range(total.shape[1]):
            if total[j, i, 3] > 0:
                for c in range(3):
                    out[j, i, c] = total[j, i, c] / total[j, i, 3]
            else:
                _between(coarse, above, first + j, i, out[j, i])
    return out


@njit
def _at(coarse: np.ndarray, above: int, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    out = np.empty((len(row), 3), np.float32)
    for n in range(len(row)):
        _between(coarse, above, row[n], column[n], out[n])
    return out
