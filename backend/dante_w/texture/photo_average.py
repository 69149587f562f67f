"""Photos averaged on the texture: the baseline, with the photos' light in it.

Samples are splatted bilinearly into a pyramid of (colour x weight, weight), each on the level whose cells are
about as wide as its pixel. The finest level with weight wins; where the photos are coarser than the texels
the coarser level is interpolated, so there are no holes between pixels. The two blend over about one coarse
cell. Where there is no photo the texture is filled by push-pull. All linear.

Memory: at most 21 bytes per texel, taken when a level is first used, however many samples come.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from dante_w.core.jit import njit
from dante_w.texture.push_pull import pull, push


class PhotoAverage:
    """`add` samples, then `resolve` once.

    >>> average = PhotoAverage(64, 64)
    >>> average.add(np.array([[0.5, 0.5]]), np.array([[0.2, 0.4, 0.6]]), np.ones(1), np.ones(1))
    >>> average.resolve()[0, 0].astype(float).round(3).tolist()
    [0.2, 0.4, 0.6]
    """

    def __init__(self, width: int, height: int) -> None:
        """A texture of width x height texels.

        Raises:
            ValueError: it is empty.
        """
        if width < 1 or height < 1:
            raise ValueError(f"texture of {width} x {height} texels")
        self.width, self.height = width, height
        self._levels: list[np.ndarray] = []
        w, h = width, height
        while True:
            self._levels.append(np.zeros((h, w, 4), np.float32))  # untouched pages cost no memory
            if w == h == 1:
                break
            w, h = (w + 1) // 2, (h + 1) // 2

    def add(
        self, uv: np.ndarray, colour: np.ndarray, weight: np.ndarray | float, footprint: np.ndarray | float
    ) -> None:
        """Splat samples. Those with a value that is not finite, outside [0, 1] or without positive weight are ignored.

        Args:
            uv: (N, 2) texture coordinates, v up.
            colour: (N, 3), linear.
            weight: (N,) or one number.
            footprint: (N,) or one number, in texels, as for `coverage.mark`.
        """
        uv = np.asarray(uv, np.float64).reshape(-1, 2)
        colour = np.asarray(colour, np.float32).reshape(-1, 3)
        weights = np.broadcast_to(np.asarray(weight, np.float32), (len(uv),))
        size = np.broadcast_to(np.asarray(footprint, np.float64), (len(uv),))
        good = np.logical_and.reduce((uv >= 0) & (uv <= 1), axis=1) & np.isfinite(colour).all(axis=1)
        good &= np.isfinite(weights) & (weights > 0) & np.isfinite(size)
        # The tents of the 2 x 2 nearest cells leave no hole between pixels if a cell is footprint / sqrt(2)
        # or wider.
        level = np.ceil(np.log2(np.maximum(size[good] * math.sqrt(0.5), 1.0))).astype(np.int64)
        level = np.minimum(level, len(self._levels) - 1)
        x, y = uv[good, 0] * self.width, (1.0 - uv[good, 1]) * self.height
        colour, weights = colour[good], weights[good]
        for k in np.unique(level):
            members = level == k
            cells = x[members] / 2.0**k, y[members] / 2.0**k
            _splat(self._levels[k], *cells, colour[members], weights[members])

    def resolve(self) -> np.ndarray:
        """(H, W, 3) float32 linear view: the average, every texel filled (0.5 if there was no sample).

        Works in place; no `add` after this.
        """
        levels = self._levels
        for fine, coarse in pairwise(levels):
            pull(fine, coarse)
        if not levels[-1][0, 0, 3] > 0:
            levels[-1][0, 0] = (0.5, 0.5, 0.5, 1.0)
        push(levels[-1], 0, levels[-1], 0, levels[-1])
        for k in range(len(levels) - 2, -1, -1):
            push(levels[k], 0, levels[k + 1], 0, levels[k])
        del levels[1:]
        return levels[0][..., :3]


@njit
def _splat(level: np.ndarray, x: np.ndarray, y: np.ndarray, colour: np.ndarray, weight: np.ndarray) -> None:
    """Add samples at (x, y), in cells, to the four cells whose centres surround them."""
    rows, columns = level.shape[0], level.shape[1]
    for n in range(len(x)):
        left, top = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        right_share, low_share = x[n] - 0.5 - left, y[n] - 0.5 - top
        for b in range(2):
            j = min(max(top + b, 0), rows - 1)
            for a in range(2):
                i = min(max(left + a, 0), columns - 1)
                share = (right_share if a else 1.0 - right_share) * (low_share if b else 1.0 - low_share)
                w = np.float32(share * weight[n])
                for c in range(3):
                    level[j, i, c] += w * colour[n, c]
                level[j, i, 3] += w
