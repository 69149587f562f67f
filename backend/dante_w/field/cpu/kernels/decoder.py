"""Decoders, forward and backward, for a block of samples: one hidden layer of ReLUs.

Matrix products go by tiles of `TILE` x `TILE` weights, which stay in registers while a loop runs along the samples.
They index flat arrays: LLVM then knows that rows do not overlap and are a constant apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dante_w.core.jit import njit_inlined
from dante_w.field.cpu.kernels import BLOCK

_ZERO = np.float32(0.0)
#: The loops below are written out for this many.
TILE = 4
#: Rows of a decoder's output: three channels, and one of zeros, so that they fill a tile.
OUTPUTS = 4


class Decoder(NamedTuple):
    """out = W2 relu(W1 x + b1) + b2: `w1` (H, K), `b1` (H,), `w2` (OUTPUTS, H), `b2` (OUTPUTS,), or as many gradients.
    The last row of W2 and b2 is 0."""

    w1: np.ndarray
    b1: np.ndarray
    w2: np.ndarray
    b2: np.ndarray


@njit_inlined
def decode(decoder, x, hidden, out):  # type: ignore[no-untyped-def]
    """Decode x (K, BLOCK) into `hidden` (H, BLOCK) and `out` (OUTPUTS, BLOCK)."""
    _fill_rows(decoder.b1, hidden)
    _add_product(decoder.w1, x.reshape(-1), hidden.reshape(-1))
    for h in range(len(hidden)):
        for s in range(BLOCK):
            hidden[h, s] = max(hidden[h, s], _ZERO)
    _fill_rows(decoder.b2, out)
    _add_product(decoder.w2, hidden.reshape(-1), out.reshape(-1))


@njit_inlined
def decode_backward(decoder, x, hidden, upstream, d_hidden, d_x, gradient):  # type: ignore[no-untyped-def]
    """Gradients of `decode`, given `upstream` (OUTPUTS, BLOCK): adds to `gradient`, writes `d_x` (K, BLOCK).

    d_hidden: (H, BLOCK), scratch.
    """
    _add_sums(upstream, gradient.b2)
    _add_outer(upstream.reshape(-1), hidden.reshape(-1), gradient.w2)
    d_hidden[:] = _ZERO
    _add_product(decoder.w2.T, upstream.reshape(-1), d_hidden.reshape(-1))
    for h in range(len(hidden)):
        for s in range(BLOCK):
            d_hidden[h, s] = d_hidden[h, s] if hidden[h, s] > _ZERO else _ZERO
    _add_sums(d_hidden, gradient.b1)
    _add_outer(d_hidden.reshape(-1), x.reshape(-1), gradient.w1)
    d_x[:] = _ZERO
    _add_product(decoder.w1.T, d_hidden.reshape(-1), d_x.reshape(-1))


@njit_inlined
def _fill_rows(b, out):  # type: ignore[no-untyped-def]
    """out[h] = b[h]: (H,) to (H, BLOCK)."""
    for h in range(len(b)):
        for s in range(BLOCK):
            out[h, s] = b[h]


@njit_inlined
def _add_sums(y, bias):  # type: ignore[no-untyped-def]
    """bias += sum of y (H, BLOCK) over samples."""
    for h in range(len(y)):
        total = _ZERO
        for s in range(BLOCK):
            total += y[h, s]
        bias[h] += total


@njit_inlined
def _add_product(w, x, out):  # type: ignore[no-untyped-def]
    """out += w x: (H, K) and flat (K BLOCK,) to flat (H BLOCK,)."""
    height, inner = w.shape
    tiled_height, tiled_inner = height - height % TILE, inner - inner % TILE
    for h in range(0, tiled_height, TILE):
        o0 = h * BLOCK
        o1, o2, o3 = o0 + BLOCK, o0 + 2 * BLOCK, o0 + 3 * BLOCK
        for k in range(0, tiled_inner, TILE):
            a0 = k * BLOCK
            a1, a2, a3 = a0 + BLOCK, a0 + 2 * BLOCK, a0 + 3 * BLOCK
            w00, w01, w02, w03 = w[h, k], w[h, k + 1], w[h, k + 2], w[h, k + 3]
            w10, w11, w12, w13 = w[h + 1, k], w[h + 1, k + 1], w[h + 1, k + 2], w[h + 1, k + 3]
            w20, w21, w22, w23 = w[h + 2, k], w[h + 2, k + 1], w[h + 2, k + 2], w[h + 2, k + 3]
            w30, w31, w32, w33 = w[h + 3, k], w[h + 3, k + 1], w[h + 3, k + 2], w[h + 3, k + 3]
            for s in range(BLOCK):
                x0, x1, x2, x3 = x[a0 + s], x[a1 + s], x[a2 + s], x[a3 + s]
                out[o0 + s] += w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3
                out[o1 + s] += w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3
                out[o2 + s] += w20 * x0 + w21 * x1 + w22 * x2 + w23 * x3
                out[o3 + s] += w30 * x0 + w31 * x1 + w32 * x2 + w33 * x3
    for h in range(height):
        done = tiled_inner if h < tiled_height else 0
        for k in range(done, inner):
            for s in range(BLOCK):
                out[h * BLOCK + s] += w[h, k] * x[k * BLOCK + s]


@njit_inlined
def _add_outer(y, x, gradient):  # type: ignore[no-untyped-def]
    """gradient += y x^T: flat (H BLOCK,) and (K BLOCK,) into (H, K)."""
    height, inner = gradient.shape
    tiled_height, tiled_inner = height - height % TILE, inner - inner % TILE
    for h in range(0, tiled_height, TILE):
        o0 = h * BLOCK
        o1, o2, o3 = o0 + BLOCK, o0 + 2 * BLOCK, o0 + 3 * BLOCK
        for k in range(0, tiled_inner, TILE):
            a0 = k * BLOCK
            a1, a2, a3 = a0 + BLOCK, a0 + 2 * BLOCK, a0 + 3 * BLOCK
            t00 = t01 = t02 = t03 = t10 = t11 = t12 = t13 = _ZERO
            t20 = t21 = t22 = t23 = t30 = t31 = t32 = t33 = _ZERO
            for s in range(BLOCK):
                x0, x1, x2, x3 = x[a0 + s], x[a1 + s], x[a2 + s], x[a3 + s]
                y0, y1, y2, y3 = y[o0 + s], y[o1 + s], y[o2 + s], y[o3 + s]
                t00, t01, t02, t03 = t00 + y0 * x0, t01 + y0 * x1, t02 + y0 * x2, t03 + y0 * x3
                t10, t11, t12, t13 = t10 + y1 * x0, t11 + y1 * x1, t12 + y1 * x2, t13 + y1 * x3
                t20, t21, t22, t23 = t20 + y2 * x0, t21 + y2 * x1, t22 + y2 * x2, t23 + y2 * x3
                t30, t31, t32, t33 = t30 + y3 * x0, t31 + y3 * x1, t32 + y3 * x2, t33 + y3 * x3
            for row, t0, t1, t2, t3 in (
                (h, t00, t01, t02, t03),
                (h + 1, t10, t11, t12, t13),
                (h + 2, t20, t21, t22, t23),
                (h + 3, t30, t31, t32, t33),
            ):
                gradient[row, k] += t0
                gradient[row, k + 1] += t1
                gradient[row, k + 2] += t2
                gradient[row, k + 3] += t3
    for h in range(height):
        done = tiled_inner if h < tiled_height else 0
        for k in range(done, inner):
            total = _ZERO
            for s in range(BLOCK):
                total += y[h * BLOCK + s] * x[k * BLOCK + s]
            gradient[h, k] += total
