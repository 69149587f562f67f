"""Known colours on the texture: what pins the gain that photos alone leave open.

A spot of known albedo fixes the level and the tint of the whole texture; a spot known only to be grey fixes the
tint. In logarithms a gain is a level (the mean over the channels) and a tint (the rest), and each is the mean of
what the spots that know it ask for: the geometric mean of gains, whatever the order of the spots.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.contract.known_colour import KnownColour
from dante_w.core.color import linear_from_srgb_array

#: Radius of the disc around a spot whose median counts, in sides of the texture; at least one texel.
RADIUS = 1.0 / 256.0
#: Darker than this in linear light, half the first step of 8-bit sRGB, is black: no gain brings it anywhere.
BLACK = 0.5 / 255.0 / 12.92


def gain(texture: np.ndarray, seen: np.ndarray, known: Sequence[KnownColour]) -> np.ndarray:
    """The gain (3,) float64 on linear albedo that brings the spots to their known colours.

    Args:
        texture: (H, W, 3) linear albedo as recovered; row 0 is the top row.
        seen: (H, W) bool, the texels that a photo saw; only these count.
        known: one spot or more. With none but grey spots the gain has a geometric mean of 1.

    Raises:
        BadInput: a spot says nothing, as no photo saw it or it was recovered as black.
    """
    wanted = np.log([_wanted(texture, seen, spot) for spot in known])
    level = wanted.mean(axis=1)
    levels = level[[spot.albedo_srgb is not None for spot in known]]
    tint = (wanted - level[:, None]).mean(axis=0)
    return np.exp(tint + (levels.mean() if len(levels) else 0.0))


def _wanted(texture: np.ndarray, seen: np.ndarray, spot: KnownColour) -> np.ndarray:
    """The gain (3,) that one spot asks for; for a grey one, to a level of 1."""
    recovered = _median(texture, seen, spot)
    if recovered.min() < BLACK:
        raise BadInput(f"The {spot} was recovered as black in some channel; choose a lighter spot.")
    albedo = 1.0 if spot.albedo_srgb is None else linear_from_srgb_array(np.array(spot.albedo_srgb))
    return albedo / recovered


def _median(texture: np.ndarray, seen: np.ndarray, spot: KnownColour) -> np.ndarray:
    """Median (3,) of the seen texels of a small disc around `spot`."""
    height, width = seen.shape
    x, y = spot.u * width, (1.0 - spot.v) * height
    radius = max(RADIUS * max(width, height), 1.0)
    rows, columns = (
        np.arange(max(int(centre - radius), 0), min(int(centre + radius) + 1, side))
        for centre, side in ((y, height), (x, width))
    )
    disc = np.hypot(rows[:, None] + 0.5 - y, columns + 0.5 - x) <= radius
    box = np.ix_(rows, columns)
    counted = texture[box][disc & seen[box]].astype(np.float64)
    counted = counted[np.isfinite(counted).all(axis=1)]
    if len(counted) == 0:
        raise BadInput(f"No photo saw the {spot}; choose a spot on the mesh that photos show.")
    return np.median(counted, axis=0)
