"""Decoders, forward and backward, for a block of samples: one hidden layer of ReLUs, or the sum of a pyramid's levels.

Matrix products hold several weights in registers and run along a row's samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dante_w.jit import njit_fast
from dante_w.model.kernels import BLOCK

_ZERO = np.float32(0.0)


class Decoder(NamedTuple):
    """out = W2 relu(W1 x + b1) + b2: `w1` (H, K), `b1` (H,), `w2` (3, H), `b2` (3,), or as many gradients.

    With H = 0 there is no layer and out is the sum of x's rows, three by three."""

    w1: np.ndarray
    b1: np.ndarray
    w2: np.ndarray
    b2: np.ndarray


@njit_fast
def decode(decoder, x, hidden, out):  # type: ignore[no-untyped-def]
    """Decode x (K, BLOCK) into `hidden` (H, BLOCK) and `out` (3, BLOCK)."""
    if len(hidden) == 0:
        out[:] = _ZERO
        for k in range(len(x)):
            for s in range(BLOCK):
                out[k % 3, s] += x[k, s]
        return
    _layer(decoder.w1, decoder.b1, x, hidden)
    for h in range(len(hidden)):
        for s in range(BLOCK):
            hidden[h, s] = max(hidden[h, s], _ZERO)
    _layer(decoder.w2, decoder.b2, hidden, out)


@njit_fast
def decode_backward(decoder, x, hidden, upstream, d_hidden, d_x, gradient):  # type: ignore[no-untyped-def]
    """Gradients of `decode`, given `upstream` (3, BLOCK): adds to `gradient`, writes `d_x` (K, BLOCK).

    d_hidden: (H, BLOCK), scratch.
    """
    if len(hidden) == 0:
        for k in range(len(x)):
            for s in range(BLOCK):
                d_x[k, s] = upstream[k % 3, s]
        return
    _add_outer(upstream, hidden, gradient.w2, gradient.b2)
    _transposed(decoder.w2, upstream, d_hidden)
    for h in range(len(hidden)):
        for s in range(BLOCK):
            d_hidden[h, s] = d_hidden[h, s] if hidden[h, s] > _ZERO else _ZERO
    _add_outer(d_hidden, x, gradient.w1, gradient.b1)
    _transposed(decoder.w1, d_hidden, d_x)


@njit_fast
def _layer(w, b, x, out):  # type: ignore[no-untyped-def]
    """out = w x + b: (H, K), (H,), (K, BLOCK) to (H, BLOCK)."""
    inner = len(x)
    for h in range(len(w)):
        row = out[h]
        for s in range(BLOCK):
            row[s] = b[h]
        _add_rows(w[h], x, inner, row)


@njit_fast
def _transposed(w, y, out):  # type: ignore[no-untyped-def]
    """out = w^T y: (H, K), (H, BLOCK) to (K, BLOCK)."""
    column = np.empty(len(w), np.float32)
    for k in range(w.shape[1]):
        row = out[k]
        for h in range(len(w)):
            column[h] = w[h, k]
        for s in range(BLOCK):
            row[s] = _ZERO
        _add_rows(column, y, len(w), row)


@njit_fast
def _add_rows(w, x, inner, row):  # type: ignore[no-untyped-def]
    """row += sum over k of w[k] x[k], four k at a time."""
    k = 0
    while k + 4 <= inner:
        w0, w1, w2, w3 = w[k], w[k + 1], w[k + 2], w[k + 3]
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        for s in range(BLOCK):
            row[s] += w0 * x0[s] + w1 * x1[s] + w2 * x2[s] + w3 * x3[s]
        k += 4
    while k < inner:
        for s in range(BLOCK):
            row[s] += w[k] * x[k, s]
        k += 1


@njit_fast
def _add_outer(y, x, gradient, bias):  # type: ignore[no-untyped-def]
    """gradient += y x^T and bias += sum of y over samples: (H, BLOCK), (K, BLOCK) into (H, K), (H,)."""
    inner = len(x)
    for h in range(len(y)):
        row = y[h]
        total = _ZERO
        for s in range(BLOCK):
            total += row[s]
        bias[h] += total
        k = 0
        while k + 4 <= inner:
            x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
            t0 = t1 = t2 = t3 = _ZERO
            for s in range(BLOCK):
                t0 += row[s] * x0[s]
                t1 += row[s] * x1[s]
                t2 += row[s] * x2[s]
                t3 += row[s] * x3[s]
            gradient[h, k] += t0
            gradient[h, k + 1] += t1
            gradient[h, k + 2] += t2
            gradient[h, k + 3] += t3
            k += 4
        while k < inner:
            t0 = _ZERO
            for s in range(BLOCK):
                t0 += row[s] * x[k, s]
            gradient[h, k] += t0
            k += 1
