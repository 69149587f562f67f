"""Adam (Kingma & Ba, 2015) for parameters of which a batch touches a part."""

from __future__ import annotations

import math

import numpy as np

from dante_w.core.jit import njit_fast, njit_inlined

BETA_1, BETA_2, EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)
#: Numbers that are passed over together when no sample touched them: two cache lines.
LINE = 32
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@njit_fast
def adam(value, mean, square, gradient, rate, root):  # type: ignore[no-untyped-def]
    """One step; `gradient` is 0 afterwards.

    An entry whose gradient is exactly 0 stays as it is, moments and all: no sample of the batch touched it. So moments
    are those of the steps that did, while `rate` and `root` count all steps.

    Args:
        value, mean, square, gradient: (N,) float32: parameters, both moments, and the gradient.
        rate, root: float32; the learning rate over 1 - beta_1^t, and 1 over sqrt(1 - beta_2^t), at step t.
    """
    bits = gradient.view(np.int32)
    whole = len(value) - len(value) % LINE
    for first in range(0, whole, LINE):
        any_touched = np.int32(0)
        for i in range(LINE):
            any_touched |= bits[first + i]
        if any_touched != 0:
            for i in range(first, first + LINE):
                _move(value, mean, square, gradient, rate, root, i)
    for i in range(whole, len(value)):
        _move(value, mean, square, gradient, rate, root, i)


@njit_inlined
def _move(value, mean, square, gradient, rate, root, i):  # type: ignore[no-untyped-def]
    """The step on number `i`; arguments as of `adam`."""
    g, m, v = gradient[i], mean[i], square[i]
    touched = g != _ZERO
    m = BETA_1 * m + (_ONE - BETA_1) * g if touched else m
    v = BETA_2 * v + (_ONE - BETA_2) * g * g if touched else v
    step = rate * m / (math.sqrt(v) * root + EPSILON)
    value[i] -= step if touched else _ZERO
    mean[i], square[i], gradient[i] = m, v, _ZERO
