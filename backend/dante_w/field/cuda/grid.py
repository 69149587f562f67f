"""Grid encodings by the kernels of `cuda.kernels`: which levels go together, and calls on tensors. Experimental, see `cuda`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import torch

from dante_w.field.hash_encoding import GridSpec, HashGrid


@dataclass(frozen=True)
class Launch:
    """How much one program of a kernel does."""

    #: Points that are encoded, or whose gradients are added up: a power of two.
    points: int = 128
    #: Numbers that Adam changes: a power of two.
    numbers: int = 1024


LAUNCH = Launch()


@dataclass(frozen=True)
class AdamStep:
    """At step t: the learning rate over 1 - beta_1^t, 1 over sqrt(1 - beta_2^t), and t, the seed of the rounding."""

    rate: float
    root: float
    seed: int


@dataclass(frozen=True)
class Group:
    """Levels whose gradients are added up together: `levels` of them from `first` on, `entries` in all from `start` on."""

    first: int
    levels: int
    start: int
    entries: int


def supports(grid: HashGrid) -> bool:
    """Whether these kernels run on the grid, where it is."""
    tables = grid.tables
    return tables.device.type == "cuda" and tables.dtype == torch.float32 and failure() is None


@cache
def failure() -> str | None:
    """Why Triton does not work with the GPU here, or None. It comes with torch's CUDA wheels for Linux, and its launcher
    wants a C compiler."""
    if find_spec("triton") is None:
        return "triton is not installed"
    try:
        point = torch.zeros(1, 2, device="cuda")
        tables = torch.ones(4, 1, device="cuda")
        encoded = encode(point, tables, GridSpec(2, 1, 1, 1, 1, 2))
        return None if float(encoded) == 1.0 else "it computes wrong results"
    except Exception as error:  # of compilers and drivers there is no list
        return (str(error).strip().splitlines() or [type(error).__name__])[0]


def encode(
    points: torch.Tensor, tables: torch.Tensor, spec: GridSpec, launch: Launch = LAUNCH
) -> torch.Tensor:
    """As `hash_encoding.encode_reference`, without gradients: points (N, D) to (N, L F), float32."""
    points = points.float().contiguous()
    encoded = torch.empty(len(points), spec.width, device=points.device)
    if len(points):
        grid = -(-len(points) // launch.points), spec.levels
        levels = _levels(spec, points.device)
        _kernels().encode_kernel[grid](
            points, tables, levels, encoded, len(points), *_constants(spec), launch.points
        )
    return encoded


def scatter(
    points: torch.Tensor,
    upstream: torch.Tensor,
    spec: GridSpec,
    group: Group,
    gradient: torch.Tensor,
    launch: Launch = LAUNCH,
) -> None:
    """Add the gradients of a group's entries to the first numbers of `gradient`, given `upstream` (N, L F) of points (N, D);
    all float32 and contiguous."""
    if len(points):
        _kernels().scatter_kernel[(-(-len(points) // launch.points), group.levels)](
            points,
            upstream,
            _levels(spec, points.device),
            group.first,
            spec.width,
            gradient,
            len(points),
            *_constants(spec),
            launch.points,
        )


def adam(
    value: torch.Tensor,
    mean: torch.Tensor,
    square: torch.Tensor,
    gradient: torch.Tensor,
    step: AdamStep,
    launch: Launch = LAUNCH,
) -> None:
    """`cuda.kernels.adam_kernel` on flat tensors (N,)."""
    grid = (-(-len(value) // launch.numbers),)
    _kernels().adam_kernel[grid](
        value, mean, square, gradient, len(value), step.rate, step.root, step.seed, launch.numbers
    )


def level_groups(spec: GridSpec) -> list[Group]:
    """Neighbouring levels together while they have no more entries than the largest level alone."""
    most, groups, start = max(spec.entries), [Group(0, 0, 0, 0)], 0
    for level, entries in enumerate(spec.entries):
        last = groups[-1]
        if last.entries + entries <= most:
            groups[-1] = Group(last.first, last.levels + 1, last.start, last.entries + entries)
        else:
            groups.append(Group(level, 1, start, entries))
        start += entries
    return groups


def _constants(spec: GridSpec) -> tuple[int, int, int]:
    """The compile-time arguments of the kernels, but the block: dimensions, features, and the power of two above these."""
    return spec.dimensions, spec.features, 1 << (spec.features - 1).bit_length()


@cache
def _levels(spec: GridSpec, device: torch.device) -> torch.Tensor:
    """Resolution, first entry and number of entries of each level, (L, 3) int64."""
    starts = [sum(spec.entries[:level]) for level in range(spec.levels)]
    return torch.tensor(list(zip(spec.resolutions, starts, spec.entries, strict=True)), device=device)


@cache
def _kernels() -> Any:
    """The kernels' module; Triton may be missing."""
    from dante_w.field.cuda import kernels

    return kernels
