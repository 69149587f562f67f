"""The hash encoding on the CPU: numba kernels behind an autograd function.

Forward runs in parallel over points. Backward runs in parallel over levels, each owning its table, so there are
no data races and the sum's order, hence every bit, is the same from run to run.
"""

from __future__ import annotations

from typing import Any

import numba
import torch

from dante_w.jit import njit_parallel

#: Points handled level by level before moving on: the small tables then stay in cache.
BLOCK = 2048


def encode(
    points: torch.Tensor, tables: torch.Tensor, resolutions: torch.Tensor, offsets: torch.Tensor
) -> torch.Tensor:
    """Encode points (N, D), D = 2 or 3, as (N, L * F); see `hash_encoding.HashGrid`."""
    encoded: torch.Tensor = _Encode.apply(points, tables, resolutions, offsets)
    return encoded


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, points: torch.Tensor, tables: torch.Tensor, resolutions: Any, offsets: Any
    ) -> torch.Tensor:
        points = points.detach().to(tables.dtype).contiguous()
        levels, features = len(resolutions), tables.shape[1]
        encoded = torch.empty(len(points), levels * features, dtype=tables.dtype)
        arguments = (points.numpy(), resolutions.to(tables.dtype).numpy(), offsets.numpy())
        kernel = _forward_2d if points.shape[1] == 2 else _forward_3d
        kernel(*arguments, tables.detach().numpy(), encoded.numpy())
        ctx.arguments, ctx.shape = arguments, tables.shape
        return encoded

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[None, torch.Tensor, None, None]:
        (gradient,) = gradients
        result = torch.zeros(ctx.shape, dtype=gradient.dtype)
        kernel = _backward_2d if ctx.arguments[0].shape[1] == 2 else _backward_3d
        kernel(*ctx.arguments, gradient.contiguous().numpy(), result.numpy())
        return None, result, None, None


@numba.njit(inline="always")
def _cell(coordinate, resolution):  # type: ignore[no-untyped-def]
    """Lower vertex and fraction along one axis; NaN and points outside count as the nearest edge."""
    scaled = coordinate * resolution
    if not scaled > 0.0:
        return 0, scaled * 0 if scaled == scaled else resolution * 0
    if scaled >= resolution:
        return int(resolution) - 1, resolution / resolution
    low = int(scaled)
    return low, scaled - low


@numba.njit(inline="always")
def _index_2d(x, y, side, entries, dense):  # type: ignore[no-untyped-def]
    if dense:
        return x + y * side
    return (x ^ (y * 2654435761)) & (entries - 1)


@numba.njit(inline="always")
def _index_3d(x, y, z, side, entries, dense):  # type: ignore[no-untyped-def]
    if dense:
        return x + (y + z * side) * side
    return (x ^ (y * 2654435761) ^ (z * 805459861)) & (entries - 1)


@njit_parallel
def _forward_2d(points, resolutions, offsets, tables, encoded):  # type: ignore[no-untyped-def]
    features = tables.shape[1]
    for block in numba.prange((len(points) + BLOCK - 1) // BLOCK):
        for level in range(len(resolutions)):
            resolution = resolutions[level]
            side = int(resolution) + 1
            start, entries = offsets[level], offsets[level + 1] - offsets[level]
            dense = side * side <= entries
            for i in range(block * BLOCK, min((block + 1) * BLOCK, len(points))):
                x, fx = _cell(points[i, 0], resolution)
                y, fy = _cell(points[i, 1], resolution)
                a = start + _index_2d(x, y, side, entries, dense)
                b = start + _index_2d(x + 1, y, side, entries, dense)
                c = start + _index_2d(x, y + 1, side, entries, dense)
                d = start + _index_2d(x + 1, y + 1, side, entries, dense)
                for f in range(features):
                    low = tables[a, f] + fx * (tables[b, f] - tables[a, f])
                    high = tables[c, f] + fx * (tables[d, f] - tables[c, f])
                    encoded[i, level * features + f] = low + fy * (high - low)


@njit_parallel
def _backward_2d(points, resolutions, offsets, gradient, result):  # type: ignore[no-untyped-def]
    features = result.shape[1]
    for reverse in numba.prange(len(resolutions)):
        level = len(resolutions) - 1 - reverse  # the finest, slowest levels first
        resolution = resolutions[level]
        side = int(resolution) + 1
        start, entries = offsets[level], offsets[level + 1] - offsets[level]
        dense = side * side <= entries
        for i in range(len(points)):
            x, fx = _cell(points[i, 0], resolution)
            y, fy = _cell(points[i, 1], resolution)
            a = start + _index_2d(x, y, side, entries, dense)
            b = start + _index_2d(x + 1, y, side, entries, dense)
            c = start + _index_2d(x, y + 1, side, entries, dense)
            d = start + _index_2d(x + 1, y + 1, side, entries, dense)
            for f in range(features):
                g = gradient[i, level * features + f]
                high = g * fy
                low = g - high
                result[b, f] += low * fx
                result[a, f] += low - low * fx
                result[d, f] += high * fx
                result[c, f] += high - high * fx


@njit_parallel
def _forward_3d(points, resolutions, offsets, tables, encoded):  # type: ignore[no-untyped-def]
    features = tables.shape[1]
    for block in numba.prange((len(points) + BLOCK - 1) // BLOCK):
        for level in range(len(resolutions)):
            resolution = resolutions[level]
            side = int(resolution) + 1
            start, entries = offsets[level], offsets[level + 1] - offsets[level]
            dense = side * side * side <= entries
            for i in range(block * BLOCK, min((block + 1) * BLOCK, len(points))):
                x, fx = _cell(points[i, 0], resolution)
                y, fy = _cell(points[i, 1], resolution)
                z, fz = _cell(points[i, 2], resolution)
                for f in range(features):
                    encoded[i, level * features + f] = 0.0
                for corner in range(8):
                    bx, by, bz = corner & 1, (corner >> 1) & 1, corner >> 2
                    weight = (fx if bx else 1 - fx) * (fy if by else 1 - fy) * (fz if bz else 1 - fz)
                    entry = start + _index_3d(x + bx, y + by, z + bz, side, entries, dense)
                    for f in range(features):
                        encoded[i, level * features + f] += weight * tables[entry, f]


@njit_parallel
def _backward_3d(points, resolutions, offsets, gradient, result):  # type: ignore[no-untyped-def]
    features = result.shape[1]
    for reverse in numba.prange(len(resolutions)):
        level = len(resolutions) - 1 - reverse
        resolution = resolutions[level]
        side = int(resolution) + 1
        start, entries = offsets[level], offsets[level + 1] - offsets[level]
        dense = side * side * side <= entries
        for i in range(len(points)):
            x, fx = _cell(points[i, 0], resolution)
            y, fy = _cell(points[i, 1], resolution)
            z, fz = _cell(points[i, 2], resolution)
            for corner in range(8):
                bx, by, bz = corner & 1, (corner >> 1) & 1, corner >> 2
                weight = (fx if bx else 1 - fx) * (fy if by else 1 - fy) * (fz if bz else 1 - fz)
                entry = start + _index_3d(x + bx, y + by, z + bz, side, entries, dense)
                for f in range(features):
                    result[entry, f] += weight * gradient[i, level * features + f]
