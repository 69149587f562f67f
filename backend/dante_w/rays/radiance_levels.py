"""The level of float photos: their radiance may have any scale, and each photo its own."""

from __future__ import annotations

import numpy as np

from dante_w.core.color import linear_from_srgb_array, srgb_from_linear_array

#: This part of a float photo's samples is brought to this linear value or below: its radiance may have any scale, but
#: halves and what is taken for noise, or for clipped, do not.
BELOW_WHITE, NEARLY_WHITE = 0.99, 0.9
#: Brighter than this they all count alike: glints and broken pixels may be a million times as bright.
GLARING = 8.0


def levelled(srgb: np.ndarray) -> tuple[np.ndarray, float]:
    """Encoded colours (N, 3) of linear ones times what brings `BELOW_WHITE` of them below `NEARLY_WHITE`, and the log of
    that factor; a photo without light stays as it is."""
    linear = linear_from_srgb_array(srgb)
    bright = float(np.quantile(linear.max(axis=1), BELOW_WHITE)) if len(linear) else 0.0
    if bright < np.finfo(np.float32).tiny:
        return srgb, 0.0
    factor = NEARLY_WHITE / bright
    return srgb_from_linear_array(np.minimum(linear * np.float32(factor), GLARING)), float(np.log(factor))
