"""Known colours on the texture: what pins the gain that photos alone leave open.

A spot of known albedo fixes the albedo scale and the white balance of the whole texture; a spot known only to be grey
fixes the white balance. In logarithms a gain is a scale (the mean over the channels) and a white balance (the rest).
Each is the mean over the spots that fix it: the geometric mean of gains, whatever the order of the spots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.contract.known_colour import KnownColour
from dante_w.core.color import linear_from_srgb_array
from dante_w.texture.bake import Texels
from dante_w.texture.coverage import Coverage, seen_texels


@dataclass(frozen=True)
class KnownColourSettings:
    """How the recovered colour of a spot is looked up."""

    #: Texels a side at which the texture is looked up, at most: a disc then has 50 of them, for a steady median.
    side: int = 1024
    #: Sides of the texture: radius of the disc around a spot whose median counts; at least one texel.
    radius: float = 1.0 / 256.0
    #: Linear value, half the first step of 8-bit sRGB: darker is black, and no gain brings it anywhere.
    black: float = 0.5 / 255.0 / 12.92


KNOWN_COLOURS = KnownColourSettings()


def known_gain(
    texels: Texels,
    coverage: Coverage,
    spots: Sequence[KnownColour],
    settings: KnownColourSettings = KNOWN_COLOURS,
) -> np.ndarray:
    """The gain (3,) float64 on linear albedo that brings `texels` to the known colours; 1 if there are none.

    Raises:
        BadInput: see `gain`.
    """
    if not spots:
        return np.ones(3)
    side = min(coverage.width, settings.side)
    centre = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(centre, 1.0 - centre)
    texture = texels(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(side, side, 3)
    place = (centre * coverage.width).astype(np.int64)
    return gain(texture, seen_texels(coverage)[np.ix_(place, place)], spots, settings)


def gain(
    texture: np.ndarray,
    seen: np.ndarray,
    spots: Sequence[KnownColour],
    settings: KnownColourSettings = KNOWN_COLOURS,
) -> np.ndarray:
    """The gain (3,) float64 on linear albedo that brings the spots to their known colours.

    Args:
        texture: (H, W, 3) linear albedo as recovered; row 0 is the top row.
        seen: (H, W) bool, the texels that a photo saw; only these count.
        spots: one or more. With none but grey spots the gain has a geometric mean of 1.

    Raises:
        BadInput: a spot is of no use, as no photo saw it or it was recovered as black.
    """
    log_gain = np.log([_spot_gain(texture, seen, spot, settings) for spot in spots])
    log_scale = log_gain.mean(axis=1)
    known_scale = log_scale[[spot.albedo_srgb is not None for spot in spots]]
    white_balance = (log_gain - log_scale[:, None]).mean(axis=0)
    return np.exp(white_balance + (known_scale.mean() if len(known_scale) else 0.0))


def _spot_gain(
    texture: np.ndarray, seen: np.ndarray, spot: KnownColour, settings: KnownColourSettings
) -> np.ndarray:
    """The gain (3,) by one spot alone; for a grey one, to an albedo of 1."""
    recovered = _median(texture, seen, spot, settings.radius)
    if recovered.min() < settings.black:
        raise BadInput(f"The {spot} was recovered as black in some channel; choose a lighter spot.")
    albedo = 1.0 if spot.albedo_srgb is None else linear_from_srgb_array(np.array(spot.albedo_srgb))
    return albedo / recovered


def _median(texture: np.ndarray, seen: np.ndarray, spot: KnownColour, radius: float) -> np.ndarray:
    """Median (3,) of the seen texels of a disc around `spot`, of that radius in sides of the texture."""
    height, width = seen.shape
    x, y = spot.u * width, (1.0 - spot.v) * height
    radius = max(radius * max(width, height), 1.0)
    rows, columns = (
        np.arange(max(int(centre - radius), 0), min(int(centre + radius) + 1, side))
        for centre, side in ((y, height), (x, width))
    )
    disc = np.hypot(rows[:, None] + 0.5 - y, columns + 0.5 - x) <= radius
    box = np.ix_(rows, columns)
    colours = texture[box][disc & seen[box]].astype(np.float64)
    colours = colours[np.isfinite(colours).all(axis=1)]
    if len(colours) == 0:
        raise BadInput(f"No photo saw the {spot}; choose a spot on the mesh that photos show.")
    return np.median(colours, axis=0)
