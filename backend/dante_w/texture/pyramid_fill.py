"""Smooth filling of the texels that no photo saw: push-pull in bands, with memory fixed whatever the texture's size.

A cell of level l holds the mean of the known texels among its 2^l x 2^l. The coarse levels, of a bounded number of cells
a side, are kept whole and summed up as known texels stream in. The finer ones are made again for each band of rows from
its own texels, with the same result.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dante_w.texture.push_pull import interpolate_at, pull, pull_known, push, scatter

#: Linear grey where not one texel is known.
NOTHING_KNOWN = 0.5


@dataclass
class Pyramid:
    """Make one with `empty_pyramid`; `add` every known texel, `solve`, then `fill` band by band.

    Attributes:
        width, height: texels of the texture.
        level: the finest level kept whole; its cells are 2^level texels wide.
        total: (h, w, 4) float32 sums of linear colour and count there.
        filled: levels `level`, level + 1, ..., each (h, w, 3) float32 linear colours.
    """

    width: int
    height: int
    level: int
    total: np.ndarray
    filled: list[np.ndarray] = field(default_factory=list)

    def add(self, row: np.ndarray, column: np.ndarray, colour: np.ndarray) -> None:
        """Known texels: (N,) rows and columns, (N, 3) float32 linear colours."""
        scatter(self.total, row >> self.level, column >> self.level, colour)

    def solve(self) -> None:
        """Fill the levels kept; no `add` after this."""
        totals = [self.total]
        while max(totals[-1].shape[:2]) > 1:
            totals.append(_pulled(totals[-1]))
        grey = np.full((1, 1, 3), NOTHING_KNOWN, np.float32)
        filled = [_pushed(totals.pop(), 0, grey, 0)]
        while totals:
            filled.append(_pushed(totals.pop(), 0, filled[-1], 0))
        self.filled = filled[::-1]
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
        """(N, 3) float32 linear colours for the unknown texels at (row, column), int64 (N,), of a band of rows.

        Args:
            rows: first row of the band and the row after its last.
            colour: (n, W, 3) float32, linear, for the rows `needs(rows)`; read where known.
            known: (n, W) bool for the same rows.
        """
        if self.level == 0:
            return self.filled[0][row, column]
        first = self.needs(rows)[0]  # a multiple of 2^level, so pairs of rows start at its row on every level
        totals: list[np.ndarray] = []
        for _ in range(1, self.level):
            totals.append(_pulled(totals[-1]) if totals else _pulled_known(colour, known))
        finer, top = self.filled[0], 0
        for level in range(self.level - 1, 0, -1):
            finer, top = _pushed(totals.pop(), first >> level, finer, top), first >> level
        out = np.empty((len(row), 3), np.float32)
        interpolate_at(finer, top, row, column, out)
        return out


def empty_pyramid(width: int, height: int, largest_kept: int) -> Pyramid:
    """A pyramid for a texture of width x height texels, none known; levels of at most `largest_kept` cells a side are kept
    whole."""
    level = 0
    while max(width, height) > largest_kept << level:
        level += 1
    cell = 1 << level
    return Pyramid(width, height, level, np.zeros((-(-height // cell), -(-width // cell), 4), np.float32))


def _empty_above(rows: int, columns: int) -> np.ndarray:
    return np.zeros(((rows + 1) // 2, (columns + 1) // 2, 4), np.float32)


def _pulled(fine: np.ndarray) -> np.ndarray:
    coarse = _empty_above(*fine.shape[:2])
    pull(fine, coarse)
    return coarse


def _pulled_known(colour: np.ndarray, known: np.ndarray) -> np.ndarray:
    coarse = _empty_above(*known.shape)
    pull_known(colour, known, coarse)
    return coarse


def _pushed(total: np.ndarray, first: int, coarse: np.ndarray, coarse_first: int) -> np.ndarray:
    out = np.empty((*total.shape[:2], 3), np.float32)
    push(total, first, coarse, coarse_first, out)
    return out
