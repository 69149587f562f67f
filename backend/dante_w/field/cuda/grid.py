"""Grid encodings by the kernels of `triton_kernels`: which levels go together, and calls on tensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from dante_w.field.hash_encoding import GridSpec, HashGrid

#: Points of a program, and numbers of a program of Adam.
BLOCK, ADAM_BLOCK = 128, 1024


@dataclass(frozen=True)
class Group:
    """Levels whose gradients are added up together: `levels` of them from `first` on, `entries` in all from `start` on."""

    first: int
    levels: int
    start: int
    entries: int


def computes(grid: HashGrid) -> bool:
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
        encoded = torch.empty(1, 1, device="cuda")
        _kernels().encode_kernel[(1, 1)](
            point,
            torch.ones(4, 1, device="cuda"),
            torch.tensor([[1, 0, 4]], device="cuda"),
            encoded,
            1,
            2,
            1,
            1,
            16,
        )
        return None if float(encoded) == 1.0 else "it computes wrong results"
    except Exception as error:  # of compilers and drivers there is no list
        return (str(error).strip().splitlines() or [type(error).__name__])[0]


def encode(points: torch.Tensor, tables: torch.Tensor, spec: GridSpec) -> torch.Tensor:
    """As `hash_encoding.encode_reference`, without gradients: points (N, D) to (N, L F), float32."""
    points = points.float().contiguous()
    encoded = torch.empty(len(points), spec.width, device=points.device)
    if len(points):
        grid = -(-len(points) // BLOCK), spec.levels
        _kernels().encode_kernel[grid](
            points, tables, _levels(spec, points.device), encoded, len(points), *_constants(spec)
        )
    return encoded


def scatter(
    points: torch.Tensor, upstream: torch.Tensor, spec: GridSpec, group: Group, gradient: torch.Tensor
) -> None:
    """Add the gradients of a group's entries to the first numbers of `gradient`, given `upstream` (N, L F) of points (N, D);
    all float32 and contiguous."""
    if len(points):
        _kernels().scatter_kernel[(-(-len(points) // BLOCK), group.levels)](
            points,
            upstream,
            _levels(spec, points.device),
            group.first,
            spec.width,
            gradient,
            len(points),
            *_constants(spec),
        )


def adam(
    value: torch.Tensor,
    mean: torch.Tensor,
    square: torch.Tensor,
    gradient: torch.Tensor,
    rate: float,
    root: float,
    seed: int,
) -> None:
    """`triton_kernels.adam_kernel` on flat tensors (N,)."""
    grid = (-(-len(value) // ADAM_BLOCK),)
    _kernels().adam_kernel[grid](value, mean, square, gradient, len(value), rate, root, seed, ADAM_BLOCK)


def groups_of(spec: GridSpec) -> list[Group]:
    """Neighbouring levels together while they have no more entries than the largest level alone."""
    most, found, start = max(spec.entries), [Group(0, 0, 0, 0)], 0
    for level, entries in enumerate(spec.entries):
        last = found[-1]
        if last.entries + entries <= most:
            found[-1] = Group(last.first, last.levels + 1, last.start, last.entries + entries)
        else:
            found.append(Group(level, 1, start, entries))
        start += entries
    return found


def _constants(spec: GridSpec) -> tuple[int, int, int, int]:
    """The compile-time arguments of the kernels."""
    width = 1 << (spec.features - 1).bit_length()
    return spec.dimensions, spec.features, width, BLOCK


@cache
def _levels(spec: GridSpec, device: torch.device) -> torch.Tensor:
    """Resolution, first entry and number of entries of each level, (L, 3) int64."""
    starts = [sum(spec.entries[:level]) for level in range(spec.levels)]
    return torch.tensor(list(zip(spec.resolutions, starts, spec.entries, strict=True)), device=device)


@cache
def _kernels() -> Any:
    from dante_w.field.cuda import kernels as triton_kernels

    return triton_kernels
