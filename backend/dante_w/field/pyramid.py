"""A texture pyramid: albedo as the sigmoid of a sum of textures, each twice as fine as the one before.

It is a `HashGrid` of three features without hashing, values at texel centres, and `LevelSum` in place of a decoder. Broad
colour settles in the coarse levels after few samples, detail in the fine ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from dante_w.field.hash_encoding import GridSpec

CHANNELS = 3


@dataclass(frozen=True)
class PyramidSpec:
    """Sides in texels of the smallest and the largest texture."""

    coarsest: int
    finest: int

    @property
    def grid(self) -> GridSpec:
        levels = max(round(math.log2(self.finest / self.coarsest)), 0) + 1
        whole = math.ceil(2.0 * math.log2(self.finest))
        return GridSpec(2, levels, CHANNELS, self.coarsest, self.finest, whole, centred=True)


class LevelSum(torch.nn.Module):
    """Encoded points (N, L * 3) to the sum (N, 3) of their levels."""

    def forward(self, encoded: torch.Tensor) -> torch.Tensor:
        return encoded.unflatten(1, (-1, CHANNELS)).sum(1)
