"""How fine the model's grids are: no finer than what they are to hold, and the paper's ablation without a gap."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dante_w.field.fields import FieldSpec
from dante_w.rays.footprint import sharp_footprint
from dante_w.rays.ray_cache import RayCache


@dataclass(frozen=True)
class ResolutionSettings:
    """How the albedo's finest resolution is chosen. Leaving out what is finer than the photos costs no accuracy on average
    and saves a quarter of the fit's time."""

    #: Samples whose footprints are looked at.
    samples: int = 1 << 17
    #: Albedo is at least this many times finer than irradiance: the gap separates them.
    least_gap: int = 4


RESOLUTION = ResolutionSettings()


def limit_resolution(
    spec: FieldSpec, texture_size: int, cache: RayCache, settings: ResolutionSettings = RESOLUTION
) -> FieldSpec:
    """`spec` with albedo no finer than the texture, nor than the sharper photos' pixels: what is finer
    costs time and holds noise. Growth from level to level stays, and so does the gap to the irradiance."""
    albedo = spec.albedo
    finest = min(albedo.finest, texture_size)
    if cache.footprint is not None:
        some = cache.footprint[:: max(len(cache) // settings.samples, 1)].astype(np.float32)
        finest = min(finest, math.ceil(1.0 / max(sharp_footprint(some), 1.0 / finest)))
    finest = max(finest, min(albedo.finest, settings.least_gap * spec.irradiance.finest), albedo.coarsest)
    if albedo.levels == 1:
        return replace(spec, albedo=replace(albedo, finest=finest))
    growth = math.log(albedo.finest / albedo.coarsest) / (albedo.levels - 1)
    levels = 1 + round(math.log(finest / albedo.coarsest) / growth)
    return replace(spec, albedo=replace(albedo, finest=finest, levels=max(levels, 2)))


def with_equal_bands(spec: FieldSpec) -> FieldSpec:
    """The paper's ablation: irradiance with the albedo's resolutions, so that nothing separates them."""
    fine = replace(spec.irradiance, levels=spec.albedo.levels, finest=spec.albedo.finest)
    return replace(spec, irradiance=fine)
