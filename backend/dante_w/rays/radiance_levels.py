"""The gain that brings a float photo into range: its radiance may have any scale, and each photo its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dante_w.core.color import linear_from_srgb_array, srgb_from_linear_array


@dataclass(frozen=True)
class RadianceSettings:
    """Where a float photo's colours are brought: halves, and what is taken for noise or for clipped, have a fixed range."""

    #: This part of the samples, by their largest channel, ...
    below_white: float = 0.99
    #: ... is brought to this linear value or below.
    nearly_white: float = 0.9
    #: Linear value: brighter samples all count alike. Glints and broken pixels may be a million times as bright.
    brightest: float = 8.0


RADIANCE = RadianceSettings()


def into_range(srgb: np.ndarray, settings: RadianceSettings = RADIANCE) -> tuple[np.ndarray, float]:
    """Bring a float photo's samples into range; a photo without light stays as it is.

    Args:
        srgb: (N, 3) float32 sRGB-encoded colours, above 1 where radiance is above 1.

    Returns:
        (N, 3) float32 sRGB-encoded colours, and the log of the gain that their linear values were multiplied with.
    """
    linear = linear_from_srgb_array(srgb)
    bright = float(np.quantile(linear.max(axis=1), settings.below_white)) if len(linear) else 0.0
    if bright < np.finfo(np.float32).tiny:
        return srgb, 0.0
    gain = settings.nearly_white / bright
    return srgb_from_linear_array(np.minimum(linear * np.float32(gain), settings.brightest)), float(
        np.log(gain)
    )
