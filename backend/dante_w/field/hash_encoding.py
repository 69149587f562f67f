"""Multiresolution hash encoding (Mueller et al., Instant Neural Graphics Primitives, 2022, section 3).

A grid level of resolution N has (N + 1)^D vertices. While they fit the level's table they are stored one to one;
finer levels share entries through a spatial hash. A point is encoded as the linearly interpolated features of
its cell's corners, level after level.

Here it is in plain torch, for any device and precision: the reference of `cpu.kernels.grid` and `cuda.kernels`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch

#: Equation 4 of the paper: one factor per axis, the first left at 1 for locality in memory.
PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True)
class GridSpec:
    """Size of an encoding."""

    #: D, of the points: 2 or 3.
    dimensions: int
    #: L, the number of levels; their resolutions grow by a constant factor b.
    levels: int
    #: F, numbers of a table entry.
    features: int
    #: Cells along an axis on the first level.
    coarsest: int
    #: Cells along an axis on the last level.
    finest: int
    #: A level's table has at most 2^log2_table entries.
    log2_table: int

    @property
    def width(self) -> int:
        """Length of an encoded point."""
        return self.levels * self.features

    @property
    def resolutions(self) -> list[int]:
        """N_l = floor(N_min b^l), b = (N_max / N_min)^(1 / (L - 1)) (Eq. 2, 3)."""
        if self.levels == 1:
            return [self.coarsest]
        ratio = self.finest / self.coarsest
        # the last level is exactly `finest`, whatever the rounding of the power
        inner = [int(self.coarsest * ratio ** (i / (self.levels - 1)) + 1e-9) for i in range(self.levels - 1)]
        return [*inner, self.finest]

    @property
    def sides(self) -> list[int]:
        """Values along an axis, per level."""
        return [n + 1 for n in self.resolutions]

    @property
    def entries(self) -> list[int]:
        """Table length per level: all values of a dense level, 2^log2_table of a hashed one."""
        return [min(side**self.dimensions, 1 << self.log2_table) for side in self.sides]


class HashGrid(torch.nn.Module):
    """The trainable tables of a `GridSpec`: one (sum of entries, F) parameter, initialised U(-1e-4, 1e-4)."""

    def __init__(self, spec: GridSpec, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.spec = spec
        entries = spec.entries
        self.tables = torch.nn.Parameter(torch.empty(sum(entries), spec.features, dtype=dtype))
        torch.nn.init.uniform_(self.tables, -1e-4, 1e-4)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Encode points (N, D) as (N, L * F); see `encode_reference`."""
        return encode_reference(points, self.tables, self.spec)


def encode_reference(points: torch.Tensor, tables: torch.Tensor, spec: GridSpec) -> torch.Tensor:
    """Encode points (N, D) of [0, 1]^D as (N, L * F); gradients flow to the tables only."""
    # halves know a place to a thousandth; only values are rounded to the tables' type
    points = points.to(torch.promote_types(tables.dtype, torch.float32)).nan_to_num(0.0).clamp(0.0, 1.0)
    start, encoded = 0, []
    for resolution, side, entries in zip(spec.resolutions, spec.sides, spec.entries, strict=True):
        scaled = points * resolution
        # the far edge belongs to the last cell
        low = scaled.floor().clamp_max(side - 2)
        fraction, low = scaled - low, low.long()
        level = torch.zeros(len(points), spec.features, dtype=tables.dtype, device=tables.device)
        for corner in itertools.product((0, 1), repeat=spec.dimensions):
            vertex = low + torch.tensor(corner, device=low.device)
            weight = torch.ones(len(points), dtype=points.dtype, device=tables.device)
            for axis, bit in enumerate(corner):
                weight = weight * (fraction[:, axis] if bit else 1.0 - fraction[:, axis])
            level = (
                level + weight[:, None].to(tables.dtype) * tables[start + vertex_index(vertex, side, entries)]
            )
        encoded.append(level)
        start += entries
    return torch.cat(encoded, dim=1)


def vertex_index(vertex: torch.Tensor, side: int, entries: int) -> torch.Tensor:
    """Table entry of grid vertices (N, D): row-major on a dense level, hashed on the others."""
    dimensions = vertex.shape[1]
    if side**dimensions <= entries:
        strides = torch.tensor([side**axis for axis in range(dimensions)], device=vertex.device)
        return (vertex * strides).sum(dim=1)
    hashed = vertex[:, 0] * PRIMES[0]
    for axis in range(1, dimensions):
        hashed = hashed ^ (vertex[:, axis] * PRIMES[axis])
    return hashed & (entries - 1)
