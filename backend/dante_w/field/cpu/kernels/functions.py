"""exp, log and the sRGB encoding in float32 arithmetic that compilers turn into SIMD; right to about 1e-6.

They are series because numba's wheels come without Intel's SVML: math.exp and math.log would be calls, one number at a time.
All take and return float32 scalars.
"""

from __future__ import annotations

import numpy as np

from dante_w.core import color
from dante_w.core.jit import njit_inlined

_F = np.float32
_LOG2_E, _LN_2 = _F(np.log2(np.e)), _F(np.log(2.0))
_ZERO, _HALF, _ONE, _TWO = _F(0.0), _F(0.5), _F(1.0), _F(2.0)
# Taylor terms of 2^f; |f| <= 1/2
_P1, _P2, _P3, _P4, _P5, _P6, _P7 = (
    _F(np.log(2.0) ** n / np.prod(np.arange(1.0, n + 1.0))) for n in range(1, 8)
)
_THIRD, _FIFTH, _SEVENTH, _NINTH, _ELEVENTH, _THIRTEENTH = (_F(1.0 / n) for n in range(3, 14, 2))
_LEAST, _MOST = _F(-126.0), _F(127.0)
_TINY = _F(2.0**-126)
# of the sRGB encoding, IEC 61966-2-1
_SLOPE, _GAIN, _SHIFT, _POWER = _F(12.92), _F(1.055), _F(0.055), _F(1.0 / 2.4)
_LINEAR_END, _ENCODED_END = _F(color.LINEAR_END), _F(color.ENCODED_END)


@njit_inlined
def exp2(x):  # type: ignore[no-untyped-def]
    """2^x, held to what normal float32 numbers can be: 2^-126 to 2^127."""
    x = min(max(x, _LEAST), _MOST)
    whole = np.floor(x + _HALF)
    f = x - whole
    series = _ONE + f * (_P1 + f * (_P2 + f * (_P3 + f * (_P4 + f * (_P5 + f * (_P6 + f * _P7))))))
    return series * np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)


@njit_inlined
def log2(x):  # type: ignore[no-untyped-def]
    """log2(x); what is below 2^-126 counts as that."""
    bits = _F(max(x, _TINY)).view(np.int32)
    # mantissa in [sqrt 1/2, sqrt 2)
    power = np.int32((bits - np.int32(0x3F3504F3)) >> np.int32(23))
    mantissa = np.int32(bits - np.int32(power << np.int32(23))).view(np.float32)
    t = (mantissa - _ONE) / (mantissa + _ONE)
    q = t * t
    series = t * (_ONE + q * (_THIRD + q * (_FIFTH + q * (_SEVENTH + q * _NINTH))))
    return _F(power) + _TWO * _LOG2_E * series


@njit_inlined
def exp(x):  # type: ignore[no-untyped-def]
    """e^x, held to the same range."""
    return exp2(x * _LOG2_E)


@njit_inlined
def log(x):  # type: ignore[no-untyped-def]
    """ln(x); what is below 2^-126 counts as that."""
    return log2(x) * _LN_2


@njit_inlined
def sigmoid(x):  # type: ignore[no-untyped-def]
    """1 / (1 + e^-x)."""
    return _ONE / (_ONE + exp(-x))


@njit_inlined
def softplus(x):  # type: ignore[no-untyped-def]
    """log(1 + e^x) = max(x, 0) + log(1 + y), y = e^-|x| in (0, 1]; its logarithm is 2 artanh(y / (2 + y))."""
    y = exp(-abs(x))
    t = y / (_TWO + y)
    q = t * t
    tail = _SEVENTH + q * (_NINTH + q * (_ELEVENTH + q * _THIRTEENTH))
    return max(x, _ZERO) + _TWO * t * (_ONE + q * (_THIRD + q * (_FIFTH + q * tail)))


@njit_inlined
def srgb_from_linear(linear):  # type: ignore[no-untyped-def]
    """(encoded value, slope there) as `color.srgb_from_linear`."""
    bright = max(linear, _LINEAR_END)
    power = exp2(_POWER * log2(bright))
    straight = linear <= _LINEAR_END
    value = _SLOPE * linear if straight else _GAIN * power - _SHIFT
    slope = _SLOPE if straight else _GAIN * _POWER * power / bright
    return value, slope


@njit_inlined
def linear_from_srgb(encoded):  # type: ignore[no-untyped-def]
    """As `color.linear_from_srgb`."""
    curved = exp2(_F(2.4) * log2((max(encoded, _ENCODED_END) + _SHIFT) / _GAIN))
    return encoded / _SLOPE if encoded <= _ENCODED_END else curved
