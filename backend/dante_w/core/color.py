"""The sRGB curve (IEC 61966-2-1), continued beyond [0, 1] so that values and gradients stay finite everywhere.

Encoding takes linear light to sRGB values, decoding takes them back; both by element, in the dtype and shape given.
"""

from __future__ import annotations

import numpy as np
import torch

#: Where the curve's two pieces meet, linear and encoded. With the standard's rounded 0.0031308 they miss each other by
#: 2e-8, and the curve falls there.
LINEAR_END, ENCODED_END = 0.003130668442500569, 0.04044823627710735


def srgb_from_linear(linear: torch.Tensor) -> torch.Tensor:
    """Encode linear values; the straight piece continues below 0, the power above 1."""
    curved = 1.055 * linear.clamp_min(LINEAR_END) ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= LINEAR_END, 12.92 * linear, curved)


def linear_from_srgb(srgb: torch.Tensor) -> torch.Tensor:
    """Decode sRGB values; inverse of `srgb_from_linear`."""
    curved = ((srgb.clamp_min(ENCODED_END) + 0.055) / 1.055) ** 2.4
    return torch.where(srgb <= ENCODED_END, srgb / 12.92, curved)


def srgb_from_linear_array(linear: np.ndarray) -> np.ndarray:
    """`srgb_from_linear` for a float array."""
    return srgb_from_linear(torch.from_numpy(np.ascontiguousarray(linear))).numpy()


def linear_from_srgb_array(srgb: np.ndarray) -> np.ndarray:
    """`linear_from_srgb` for a float array."""
    return linear_from_srgb(torch.from_numpy(np.ascontiguousarray(srgb))).numpy()
