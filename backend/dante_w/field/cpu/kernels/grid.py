"""Grid encodings of a block of points, and their transpose; see `hash_encoding` for the definition.

A level is read in two steps: which table entries a point lies between and with which weights, then the sum itself.
The transpose takes the same first step, so the two cannot disagree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dante_w.core.jit import njit_fast, njit_inlined
from dante_w.field.cpu.kernels import BLOCK

_ONE = np.float32(1.0)
_PRIME_Y, _PRIME_Z = np.uint32(2654435761), np.uint32(805459861)


class Grid(NamedTuple):
    """`tables` (entries of all levels, F) float32; level l has `resolutions`[l] and the entries from `offsets`[l] to
    `offsets`[l + 1]."""

    tables: np.ndarray
    resolutions: np.ndarray
    offsets: np.ndarray


@njit_inlined
def corners(points, resolution, entries, entry, weight):  # type: ignore[no-untyped-def]
    """The corners of the cells that points lie in.

    Args:
        points: (D, BLOCK) in [0, 1], D = 2 or 3.
        resolution, entries: of the level; the number of entries tells whether it is hashed.
        entry, weight: (2^D, BLOCK) to write: uint32 places in the level's table, and float32 weights.
    """
    if len(points) == 2:
        _corners_2d(points, resolution, entries, entry, weight)
    else:
        _corners_3d(points, resolution, entries, entry, weight)


@njit_inlined
def _corners_2d(points, resolution, entries, entry, weight):  # type: ignore[no-untyped-def]
    side = np.int32(resolution + _ONE)
    dense = np.int64(side) * np.int64(side) <= entries
    mask = np.uint32(entries - 1)
    for s in range(BLOCK):
        x, fx = _cell(points[0, s], resolution, side)
        y, fy = _cell(points[1, s], resolution, side)
        high, low = fy, _ONE - fy
        weight[0, s], weight[1, s] = low - low * fx, low * fx
        weight[2, s], weight[3, s] = high - high * fx, high * fx
        if dense:
            corner = np.int32(x + np.int32(y * side))
            entry[0, s], entry[1, s] = corner, corner + np.int32(1)
            entry[2, s], entry[3, s] = corner + side, np.int32(corner + side) + np.int32(1)
        else:
            hy = np.uint32(np.uint32(y) * _PRIME_Y)
            hy1 = np.uint32(hy + _PRIME_Y)
            x0, x1 = np.uint32(x), np.uint32(x + np.int32(1))
            entry[0, s], entry[1, s] = (x0 ^ hy) & mask, (x1 ^ hy) & mask
            entry[2, s], entry[3, s] = (x0 ^ hy1) & mask, (x1 ^ hy1) & mask


@njit_inlined
def _corners_3d(points, resolution, entries, entry, weight):  # type: ignore[no-untyped-def]
    side = np.int32(resolution + _ONE)
    dense = np.int64(side) * np.int64(side) * np.int64(side) <= entries
    mask = np.uint32(entries - 1)
    for s in range(BLOCK):
        _, fx = _cell(points[0, s], resolution, side)
        _, fy = _cell(points[1, s], resolution, side)
        _, fz = _cell(points[2, s], resolution, side)
        high, low = fz, _ONE - fz
        w00, w01, w10, w11 = low - low * fy, low * fy, high - high * fy, high * fy
        weight[0, s], weight[1, s] = w00 - w00 * fx, w00 * fx
        weight[2, s], weight[3, s] = w01 - w01 * fx, w01 * fx
        weight[4, s], weight[5, s] = w10 - w10 * fx, w10 * fx
        weight[6, s], weight[7, s] = w11 - w11 * fx, w11 * fx
    if dense:
        row, plane = np.uint32(side), np.uint32(side * side)
        for s in range(BLOCK):
            x, _ = _cell(points[0, s], resolution, side)
            y, _ = _cell(points[1, s], resolution, side)
            z, _ = _cell(points[2, s], resolution, side)
            near = np.uint32(np.uint32(x) + np.uint32(np.uint32(y) * row) + np.uint32(np.uint32(z) * plane))
            far = np.uint32(near + plane)
            entry[0, s], entry[1, s] = near, near + np.uint32(1)
            entry[2, s], entry[3, s] = near + row, np.uint32(near + row) + np.uint32(1)
            entry[4, s], entry[5, s] = far, far + np.uint32(1)
            entry[6, s], entry[7, s] = far + row, np.uint32(far + row) + np.uint32(1)
        return
    for s in range(BLOCK):
        x, _ = _cell(points[0, s], resolution, side)
        y, _ = _cell(points[1, s], resolution, side)
        z, _ = _cell(points[2, s], resolution, side)
        x0, x1 = np.uint32(x), np.uint32(x + np.int32(1))
        y0, z0 = np.uint32(np.uint32(y) * _PRIME_Y), np.uint32(np.uint32(z) * _PRIME_Z)
        y1, z1 = np.uint32(y0 + _PRIME_Y), np.uint32(z0 + _PRIME_Z)
        entry[0, s], entry[1, s] = (x0 ^ y0 ^ z0) & mask, (x1 ^ y0 ^ z0) & mask
        entry[2, s], entry[3, s] = (x0 ^ y1 ^ z0) & mask, (x1 ^ y1 ^ z0) & mask
        entry[4, s], entry[5, s] = (x0 ^ y0 ^ z1) & mask, (x1 ^ y0 ^ z1) & mask
        entry[6, s], entry[7, s] = (x0 ^ y1 ^ z1) & mask, (x1 ^ y1 ^ z1) & mask


@njit_inlined
def _cell(coordinate, resolution, side):  # type: ignore[no-untyped-def]
    """The cell that a coordinate in [0, 1] lies in, along one axis, and how far into it; the far edge belongs to the last."""
    # min() changes nothing but bars the compiler from fusing this product with the difference below
    scaled = min(coordinate * resolution, np.float32(side - 1))
    cell = min(np.int32(scaled), np.int32(side - 2))
    return cell, scaled - np.float32(cell)


@njit_inlined
def encode(grid, points, entry, weight, encoded):  # type: ignore[no-untyped-def]
    """Encode points (D, BLOCK) into `encoded` (L F, BLOCK); `entry` and `weight` are scratch, see `corners`."""
    features = grid.tables.shape[1]
    for level in range(len(grid.resolutions)):
        start, end = grid.offsets[level], grid.offsets[level + 1]
        corners(points, grid.resolutions[level], end - start, entry, weight)
        table, rows = grid.tables[start:end], encoded[level * features : (level + 1) * features]
        if features == 2:  # known lengths are loops unrolled
            if len(points) == 2:
                _sum_4(table, entry, weight, rows[0], rows[1])
            else:
                _sum_8(table, entry, weight, rows[0], rows[1])
        else:
            rows[:] = np.float32(0.0)
            for f in range(features):
                for c in range(1 << len(points)):
                    for s in range(BLOCK):
                        rows[f, s] += weight[c, s] * table[entry[c, s], f]


@njit_inlined
def _sum_4(table, entry, weight, row_0, row_1):  # type: ignore[no-untyped-def]
    """The weighted sums of four corners, for two features: into `row_0` and `row_1` (BLOCK,)."""
    for s in range(BLOCK):
        e0, e1, e2, e3 = entry[0, s], entry[1, s], entry[2, s], entry[3, s]
        w0, w1, w2, w3 = weight[0, s], weight[1, s], weight[2, s], weight[3, s]
        row_0[s] = w0 * table[e0, 0] + w1 * table[e1, 0] + w2 * table[e2, 0] + w3 * table[e3, 0]
        row_1[s] = w0 * table[e0, 1] + w1 * table[e1, 1] + w2 * table[e2, 1] + w3 * table[e3, 1]


@njit_inlined
def _sum_8(table, entry, weight, row_0, row_1):  # type: ignore[no-untyped-def]
    """The same for eight corners."""
    for s in range(BLOCK):
        e0, e1, e2, e3 = entry[0, s], entry[1, s], entry[2, s], entry[3, s]
        e4, e5, e6, e7 = entry[4, s], entry[5, s], entry[6, s], entry[7, s]
        w0, w1, w2, w3 = weight[0, s], weight[1, s], weight[2, s], weight[3, s]
        w4, w5, w6, w7 = weight[4, s], weight[5, s], weight[6, s], weight[7, s]
        near_0 = w0 * table[e0, 0] + w1 * table[e1, 0] + w2 * table[e2, 0] + w3 * table[e3, 0]
        near_1 = w0 * table[e0, 1] + w1 * table[e1, 1] + w2 * table[e2, 1] + w3 * table[e3, 1]
        far_0 = w4 * table[e4, 0] + w5 * table[e5, 0] + w6 * table[e6, 0] + w7 * table[e7, 0]
        far_1 = w4 * table[e4, 1] + w5 * table[e5, 1] + w6 * table[e6, 1] + w7 * table[e7, 1]
        row_0[s], row_1[s] = near_0 + far_0, near_1 + far_1


@njit_fast
def scatter(points, resolution, rows, first_row, gradient):  # type: ignore[no-untyped-def]
    """The transpose of encoding with one level: add upstream gradients to its entries' `gradient` (entries, F).

    points: (N, D), not held to [0, 1] yet. rows: (blocks, R, BLOCK), of which the F from `first_row` on belong to
    the level. Samples are taken in order, so sums come out the same every time.
    """
    dimensions, features = points.shape[1], gradient.shape[1]
    block = np.empty((dimensions, BLOCK), np.float32)
    entry = np.empty((1 << dimensions, BLOCK), np.uint32)
    weight = np.empty((1 << dimensions, BLOCK), np.float32)
    for first in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - first)
        load(points, first, block)
        corners(block, resolution, len(gradient), entry, weight)
        upstream = rows[first // BLOCK, first_row : first_row + features]
        if features == 2:  # known lengths are loops unrolled
            for s in range(count):
                upstream_0, upstream_1 = upstream[0, s], upstream[1, s]
                for c in range(1 << dimensions):
                    e, w = entry[c, s], weight[c, s]
                    sum_0, sum_1 = gradient[e, 0] + w * upstream_0, gradient[e, 1] + w * upstream_1
                    gradient[e, 0], gradient[e, 1] = sum_0, sum_1
        else:
            for s in range(count):
                for c in range(1 << dimensions):
                    e, w = entry[c, s], weight[c, s]
                    for f in range(features):
                        gradient[e, f] += w * upstream[f, s]


@njit_inlined
def load(points, first, block):  # type: ignore[no-untyped-def]
    """Points (N, D) from `first` on into `block` (D, BLOCK), into [0, 1]; NaN and what is past the end become 0."""
    for d in range(len(block)):
        for s in range(BLOCK):
            value = points[first + s, d] if first + s < len(points) else np.float32(0.0)
            block[d, s] = min(value, _ONE) if value > np.float32(0.0) else np.float32(0.0)
