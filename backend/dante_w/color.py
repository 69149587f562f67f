"""The sRGB transfer, continued beyond [0, 1] so that values and gradients stay finite everywhere."""

from __future__ import annotations

import numpy as np
import torch


def srgb_from_linear(linear: torch.Tensor) -> torch.Tensor:
    """Encode linear values (IEC 61966-2-1); the straight piece continues below 0, the power above 1."""
    curved = 1.055 * linear.clamp_min(0.0031308) ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curved)


def linear_from_srgb(srgb: torch.Tensor) -> torch.Tensor:
    """Decode sRGB values; inverse of `srgb_from_linear`."""
    curved = ((srgb.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(srgb <= 0.04045, srgb / 12.92, curved)


def srgb_from_linear_array(linear: np.ndarray) -> np.ndarray:
    """`srgb_from_linear` for a float array."""
    return srgb_from_linear(torch.from_numpy(np.ascontiguousarray(linear))).numpy()


def linear_from_srgb_array(srgb: np.ndarray) -> np.ndarray:
    """`linear_from_srgb` for a float array."""
    return linear_from_srgb(torch.from_numpy(np.ascontiguousarray(srgb))).numpy()
