"""The settings of the paper's model, and those of each preset. A stage's settings stand beside it."""

from __future__ import annotations

from dataclasses import dataclass

from dante_w.field.fields import FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.held_out import HELD_OUT, HeldOutSettings
from dante_w.field.optimise import FIT, FitSettings, Schedule
from dante_w.field.resolution import RESOLUTION, ResolutionSettings, limit_resolution
from dante_w.field.scale_ambiguity import SCALE, ScaleSettings
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import RayCache


@dataclass(frozen=True)
class FieldSettings:
    """Everything that the paper's model is fitted with. `bench tradeoff` measures what these numbers cost and bring."""

    #: Size of the model, at most.
    model: FieldSpec
    #: Of the main pass, which does not see the held-out photos.
    schedule: Schedule
    #: Of the pass over all photos that follows.
    final_pass: Schedule
    #: Weight of `LossTerms.white_light` in runs without priors.
    white_light: float = 0.0
    #: Weight of `LossTerms.small_offset` in runs without priors.
    small_offset: float = 0.0
    #: How albedo is made coarser where texture or photos are; None: it never is.
    resolution: ResolutionSettings | None = RESOLUTION
    held_out: HeldOutSettings = HELD_OUT
    scale: ScaleSettings = SCALE
    fit: FitSettings = FIT

    def terms(self, prior_weight: float, priors: bool, photometric: bool = True) -> LossTerms:
        """The terms of the loss of a run with or without `priors`; `photometric` is off in an ablation of the paper."""
        extra = (0.0, 0.0) if priors else (self.white_light, self.small_offset)
        return LossTerms(photometric, prior_weight, *extra)

    def spec_for(self, texture_size: int, cache: RayCache) -> FieldSpec:
        """The model's size for a texture of so many texels a side and the photos of the cache."""
        if self.resolution is None:
            return self.model
        return limit_resolution(self.model, texture_size, cache, self.resolution)


def _for_two_cores(albedo_finest: int, log2_table: int, steps: int, batch: int) -> FieldSettings:
    """A model that two CPU cores can fit.

    Irradiance that ends at resolution 16 is better than at 8, 32 or 64. A learning rate of 1e-2 gets in 400 steps to half the
    loss of 2e-3. The two terms for runs without priors bring 0.85 dB on average, after one gain per channel.
    """
    model = FieldSpec(
        albedo=GridSpec(2, levels=12, features=2, coarsest=16, finest=albedo_finest, log2_table=log2_table),
        irradiance=GridSpec(3, levels=4, features=2, coarsest=4, finest=16, log2_table=16),
        hidden=32,
    )
    main, final = Schedule(steps, batch, 1e-2), Schedule(steps // 4, batch, 2e-3)
    return FieldSettings(model, main, final, white_light=0.05, small_offset=0.2)


DRAFT = _for_two_cores(albedo_finest=1024, log2_table=17, steps=150, batch=1 << 15)
STANDARD = _for_two_cores(albedo_finest=2048, log2_table=19, steps=500, batch=1 << 15)
HIGH = _for_two_cores(albedo_finest=4096, log2_table=21, steps=2500, batch=1 << 16)
#: The released reference: grids, decoders, samples a step, and the whole of its 20 passes of 1000 steps.
PAPER = FieldSettings(
    FieldSpec(
        albedo=GridSpec(2, levels=16, features=2, coarsest=16, finest=2048, log2_table=22),
        irradiance=GridSpec(3, levels=16, features=2, coarsest=16, finest=413, log2_table=22),
        hidden=64,
    ),
    Schedule(16000, 1 << 16),
    Schedule(4000, 1 << 16, 5e-4),
    resolution=None,
)
