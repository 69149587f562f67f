"""The terms of the loss, as data. `loss.model_loss` has their formulas."""

from __future__ import annotations

from dataclasses import dataclass

#: Irradiance this low counts as black, which has no tint: the white-light term takes log(irradiance + this).
DARKNESS = 1e-3


@dataclass(frozen=True)
class LossTerms:
    """Which terms are minimised, and their weights.

    Photos leave open whether a broad tint belongs to the surface or to its light, and whether an offset takes up haze
    or colour. The last two terms are not the paper's; they decide this for runs without priors.
    """

    #: Eq. 6: whether re-rendered photos are compared with the photos.
    photometric: bool = True
    #: lambda of Eq. 7, the weight of the albedo priors.
    prior_weight: float = 1.0
    #: Weight of the light's tint, squared: light is nearly white where the photos do not say otherwise.
    white_light: float = 0.0
    #: Weight of |b_k|: a photo's offset is nearly 0 where it does not say otherwise.
    small_offset: float = 0.0
