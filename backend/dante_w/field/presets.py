"""The presets: how large the model is and how long it is fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dante_w.field.fields import ModelSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.rays.footprint import sharp_footprint
from dante_w.rays.ray_cache import RayCache

#: Without priors, on the four objects of the README: 0.85 dB more on average (after one gain per channel).
WHITE_LIGHT, SMALL_OFFSET = 0.05, 0.2

#: How many samples' footprints are looked at. On the four objects of the README, with one seed, to leave out what is finer than
#: `sharp_footprint` costs nothing on average and saves a quarter of the fit's time.
LOOKED_AT = 1 << 17
#: Albedo is at least this much finer than irradiance.
LEAST_GAP = 4


@dataclass(frozen=True)
class Preset:
    """`texture_size` is the most that a plan takes; `schedule` is the main pass, `final_pass` the one over all photos;
    `white_light` and `small_offset` (see `LossTerms`) hold for runs without priors."""

    texture_size: int
    model: ModelSpec
    schedule: Schedule
    final_pass: Schedule
    white_light: float = 0.0
    small_offset: float = 0.0


def _sized(albedo_finest: int, log2_table: int, steps: int, batch: int, texture_size: int = 2048) -> Preset:
    """A model that two CPU cores can fit. Measured without priors, irradiance that ends at resolution 16
    beats 8 and 32 on the mean of four objects and 64 on that of three; a rate of 1e-2 gets in 400 steps to half
    the loss of 2e-3."""
    model = ModelSpec(
        albedo=GridSpec(2, levels=12, features=2, coarsest=16, finest=albedo_finest, log2_table=log2_table),
        irradiance=GridSpec(3, levels=4, features=2, coarsest=4, finest=16, log2_table=16),
        hidden=32,
    )
    return Preset(
        texture_size,
        model,
        Schedule(steps, batch, 1e-2),
        Schedule(steps // 4, batch, 2e-3),
        WHITE_LIGHT,
        SMALL_OFFSET,
    )


def equal_bands(model: ModelSpec) -> ModelSpec:
    """The paper's ablation: irradiance with the albedo's resolutions, so that nothing tells them apart."""
    fine = replace(model.irradiance, levels=model.albedo.levels, finest=model.albedo.finest)
    return replace(model, irradiance=fine)


def sized(model: ModelSpec, texture_size: int, cache: RayCache) -> ModelSpec:
    """`model` with albedo no finer than the texture, nor than the sharper photos' pixels: what is finer
    costs time and holds noise. Growth from level to level stays, and so does the gap to the irradiance."""
    albedo = model.albedo
    finest = min(albedo.finest, texture_size)
    if cache.footprint is not None:
        some = cache.footprint[:: max(len(cache) // LOOKED_AT, 1)].astype(np.float32)
        finest = min(finest, math.ceil(1.0 / max(sharp_footprint(some), 1.0 / finest)))
    finest = max(finest, min(albedo.finest, LEAST_GAP * model.irradiance.finest), albedo.coarsest)
    if albedo.levels == 1:
        return replace(model, albedo=replace(albedo, finest=finest))
    growth = math.log(albedo.finest / albedo.coarsest) / (albedo.levels - 1)
    levels = 1 + round(math.log(finest / albedo.coarsest) / growth)
    return replace(model, albedo=replace(albedo, finest=finest, levels=max(levels, 2)))


PRESETS = {
    "draft": _sized(albedo_finest=1024, log2_table=17, steps=150, batch=1 << 15),
    "standard": _sized(albedo_finest=2048, log2_table=19, steps=500, batch=1 << 15),
    "high": _sized(albedo_finest=4096, log2_table=21, steps=2500, batch=1 << 16, texture_size=8192),
    # the released reference: grids, decoders, rays a step; 1000 steps a pass, up to 20 passes
    "paper": Preset(
        2048,
        ModelSpec(
            albedo=GridSpec(2, levels=16, features=2, coarsest=16, finest=2048, log2_table=22),
            irradiance=GridSpec(3, levels=16, features=2, coarsest=16, finest=413, log2_table=22),
            hidden=64,
        ),
        Schedule(16000, 1 << 16),
        Schedule(4000, 1 << 16, 5e-4),
    ),
}
