"""Linear colours to the numbers of a texture file and back: exactly rounded, fast enough for 16384^2."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dante_w.core.color import linear_from_srgb_array
from dante_w.core.jit import njit

_SHIFT = 8  # buckets of 2^15 per octave: at most a step or two of 16-bit sRGB each
_LEAST = np.float32(2.0**-21)  # encodes to 0 in 16 bits
_BASE = int(_LEAST.view(np.uint32)) >> _SHIFT


def encode_rows(linear: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Linear colours in the numbers of a texture: rounded sRGB for uint8 and uint16, else linear floats.

    Args:
        linear: float, any shape. Clipped to 0..1 for integers (NaN: 0), else to what the dtype can hold.

    Raises:
        ValueError: a dtype other than uint8, uint16, float16 and float32.
    """
    if dtype in (np.uint8, np.uint16):
        flat = np.ascontiguousarray(linear, np.float32).reshape(-1)
        codes = np.empty(flat.shape, dtype)
        _look_up(flat, flat.view(np.uint32), *_tables(np.iinfo(dtype).max), codes)
        return codes.reshape(linear.shape)
    if dtype in (np.float16, np.float32):
        most = float(np.finfo(dtype).max)
        return np.clip(linear, -most, most).astype(dtype)
    raise ValueError(f"no texture of {dtype}")


def decode_rows(rows: np.ndarray) -> np.ndarray:
    """float32 linear colours of a texture's numbers, any shape; inverse of `encode_rows` up to rounding."""
    if rows.dtype in (np.uint8, np.uint16):
        return _decoded(np.iinfo(rows.dtype).max)[rows]
    return np.asarray(rows, np.float32)


@lru_cache(maxsize=2)
def _decoded(top: int) -> np.ndarray:
    """(top + 1,) float32: the linear value of each code."""
    return linear_from_srgb_array(np.arange(top + 1) / top).astype(np.float32)


@lru_cache(maxsize=2)
def _tables(top: int) -> tuple[np.ndarray, np.ndarray]:
    """Per code the least float32 above it, (top,), and per bucket of float32 its first value's code."""
    edges = linear_from_srgb_array((np.arange(top) + 0.5) / top)
    limits = edges.astype(np.float32)
    limits = np.where(limits < edges, np.nextafter(limits, np.float32(2)), limits)
    low, high = _BASE, int(np.float32(1).view(np.uint32)) >> _SHIFT
    values = (np.arange(low, high + 1, dtype=np.uint32) << np.uint32(_SHIFT)).view(np.float32)
    return limits, np.searchsorted(limits, values, side="right").astype(np.uint16)


@njit
def _look_up(
    linear: np.ndarray, bits: np.ndarray, limits: np.ndarray, codes: np.ndarray, out: np.ndarray
) -> None:
    """Codes of linear values: the table's code for the bucket, then up past each limit reached."""
    top = len(limits)
    base = _BASE
    for n in range(len(linear)):
        x = linear[n]
        if not x >= _LEAST:  # also NaN
            out[n] = 0
        elif x >= 1.0:
            out[n] = top
        else:
            code = np.int64(codes[np.int64(bits[n] >> _SHIFT) - base])
            while code < top and x >= limits[code]:
                code += 1
            out[n] = code
