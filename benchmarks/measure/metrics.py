"""How near a picture is to the truth. Pictures are (H, W, 3) sRGB in [0, 1]; masks are (H, W) bool."""

from __future__ import annotations

import numpy as np


def psnr(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of the sRGB values where `mask` is set.

    >>> white = np.ones((2, 2, 3))
    >>> round(psnr(0.9 * white, white, np.ones((2, 2), bool)), 6)
    20.0
    """
    error = picture[mask].astype(np.float64) - truth[mask]
    return float(-10.0 * np.log10(np.mean(error**2)))


def gains(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(3,) the factor per channel that brings `picture` nearest to `truth`, least squares in linear light."""
    have, want = linear_from_srgb(picture[mask]), linear_from_srgb(truth[mask])
    return (have * want).sum(axis=0) / np.maximum((have * have).sum(axis=0), 1e-12)


def apply_gains(picture: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """`picture` with its linear colours times `factors`, encoded again and clipped to [0, 1]."""
    return srgb_from_linear(np.clip(linear_from_srgb(picture) * factors, 0.0, 1.0))


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055)
