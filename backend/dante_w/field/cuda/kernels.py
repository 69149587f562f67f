"""Grid encodings and Adam on CUDA, in Triton; see `hash_encoding` for the definition. Experimental, see `cuda`.

Import it only where `triton` is installed. With TRITON_INTERPRET=1 set before, the same kernels run on the CPU.
"""

from __future__ import annotations

import triton
import triton.language as tl

BETA_1, BETA_2, EPSILON = tl.constexpr(0.9), tl.constexpr(0.999), tl.constexpr(1e-15)
_PRIME_Y, _PRIME_Z = tl.constexpr(2654435761), tl.constexpr(805459861)
_BELOW_BFLOAT16, _BFLOAT16 = tl.constexpr(0x0000FFFF), tl.constexpr(0xFFFF0000)


@triton.jit
def encode_kernel(  # type: ignore[no-untyped-def]
    points,
    tables,
    levels,
    encoded,
    count,
    dimensions: tl.constexpr,
    features: tl.constexpr,
    width: tl.constexpr,
    block: tl.constexpr,
):
    """Encode points (N, D) into `encoded` (N, L F). A program takes a block of points and one level.

    Args:
        tables: (entries of all levels, F) float32.
        levels: (L, 3) int64: resolution, first entry and number of entries.
        count: N.
        width: the least power of two from F up. block: points of a program.
    """
    level = tl.program_id(1)
    start = tl.load(levels + 3 * level + 1)
    sample = tl.program_id(0) * block + tl.arange(0, block)
    feature = tl.arange(0, width)
    known = (sample < count)[:, None] & (feature < features)[None, :]
    total = tl.zeros((block, width), tl.float32)
    for corner in tl.static_range(1 << dimensions):
        entry, weight = _corner(points, levels, level, sample, count, corner, dimensions)
        place = entry.to(tl.int64)[:, None] * features + feature[None, :]
        total += weight[:, None] * tl.load(tables + start * features + place, known, 0.0)
    columns = tl.num_programs(1) * features
    place = sample.to(tl.int64)[:, None] * columns + level * features + feature[None, :]
    tl.store(encoded + place, total, known)


@triton.jit(do_not_specialize=["first_level"])
def scatter_kernel(  # type: ignore[no-untyped-def]
    points,
    upstream,
    levels,
    first_level,
    columns,
    gradient,
    count,
    dimensions: tl.constexpr,
    features: tl.constexpr,
    width: tl.constexpr,
    block: tl.constexpr,
):
    """The transpose of `encode_kernel` for the levels from `first_level` on: a program takes a block of points and one level
    and adds to `gradient`, which begins at the entries of `first_level`. Atomic sums: their order, and so the
    last bits, differ from run to run.

    upstream: (N, `columns`) float32, columns = L F.
    """
    level = first_level + tl.program_id(1)
    start = tl.load(levels + 3 * level + 1) - tl.load(levels + 3 * first_level + 1)
    sample = tl.program_id(0) * block + tl.arange(0, block)
    feature = tl.arange(0, width)
    known = (sample < count)[:, None] & (feature < features)[None, :]
    place = sample.to(tl.int64)[:, None] * columns + level * features + feature[None, :]
    slope = tl.load(upstream + place, known, 0.0)
    for corner in tl.static_range(1 << dimensions):
        entry, weight = _corner(points, levels, level, sample, count, corner, dimensions)
        place = entry.to(tl.int64)[:, None] * features + feature[None, :]
        tl.atomic_add(gradient + start * features + place, weight[:, None] * slope, known, sem="relaxed")


@triton.jit
def _corner(  # type: ignore[no-untyped-def]
    points, levels, level, sample, count, corner: tl.constexpr, dimensions: tl.constexpr
):
    """Entry in the level's table (block,) uint32, and weight, of one corner of the cells that points lie in."""
    resolution, entries = tl.load(levels + 3 * level), tl.load(levels + 3 * level + 2)
    side = resolution + 1
    whole = side * side
    if dimensions == 3:
        whole *= side
    weight = tl.full(sample.shape, 1.0, tl.float32)
    row_major = tl.zeros(sample.shape, tl.uint32)
    hashed = tl.zeros(sample.shape, tl.uint32)
    for axis in tl.static_range(dimensions):
        point = tl.load(points + sample.to(tl.int64) * dimensions + axis, sample < count, 0.0)
        point = tl.where(point > 0.0, tl.minimum(point, 1.0), 0.0)  # what is not a number is 0
        scaled = point * resolution.to(tl.float32)
        cell = tl.minimum(
            scaled.to(tl.int32), (side - 2).to(tl.int32)
        )  # the far edge belongs to the last cell
        fraction = scaled - cell.to(tl.float32)
        vertex = cell.to(tl.uint32)
        if (corner >> axis) & 1:
            weight *= fraction
            vertex += 1
        else:
            weight *= 1.0 - fraction
        if axis == 0:
            row_major += vertex
            hashed ^= vertex
        elif axis == 1:
            row_major += vertex * side.to(tl.uint32)
            hashed ^= vertex * _PRIME_Y
        else:
            row_major += vertex * (side * side).to(tl.uint32)
            hashed ^= vertex * _PRIME_Z
    entry = tl.where(whole <= entries, row_major, hashed & (entries - 1).to(tl.uint32))
    return entry, weight


@triton.jit(do_not_specialize=["seed"])
def adam_kernel(value, mean, square, gradient, count, rate, root, seed, block: tl.constexpr):  # type: ignore[no-untyped-def]
    """One step of Adam on `count` numbers; `gradient` is 0 afterwards. As `cpu.kernels.adam`: a number whose gradient is exactly
    0 stays as it is, moments and all.

    Args:
        value, gradient: float32. mean, square: bfloat16, rounded up or down at random so that sums of small changes
            come out right on average.
        rate, root: the learning rate over 1 - beta_1^t, and 1 over sqrt(1 - beta_2^t), at step t. seed: of the rounding.
    """
    place = tl.program_id(0).to(tl.int64) * block + tl.arange(0, block)
    g = tl.load(gradient + place, place < count, 0.0)
    touched = g != 0.0
    m = tl.load(mean + place, touched, 0.0).to(tl.float32)
    v = tl.load(square + place, touched, 0.0).to(tl.float32)
    m = BETA_1 * m + (1.0 - BETA_1) * g
    v = BETA_2 * v + (1.0 - BETA_2) * g * g
    step = rate * m / (tl.sqrt(v) * root + EPSILON)
    tl.store(value + place, tl.load(value + place, touched, 0.0) - step, touched)
    noise = tl.randint(seed, place.to(tl.int32)).to(tl.uint32)
    tl.store(mean + place, _rounded(m, noise), touched)
    tl.store(square + place, _rounded(v, noise >> 16), touched)
    tl.store(gradient + place, tl.zeros((block,), tl.float32), touched)


@triton.jit
def _rounded(x, noise):  # type: ignore[no-untyped-def]
    """float32 to bfloat16, away from zero with the probability of what is lost otherwise; `noise`: 16 random bits."""
    bits = x.to(tl.uint32, bitcast=True) + (noise & _BELOW_BFLOAT16)
    return (bits & _BFLOAT16).to(tl.float32, bitcast=True).to(tl.bfloat16)
