"""The loss of the paper's model (Eq. 6, 7), in plain torch: the reference of every other way to compute it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch

from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field.terms import DARKNESS, LossTerms
from dante_w.rays.ray_cache import Samples


class Rendered(Protocol):
    """What the loss needs of a model, as `fields.FieldModel` has it."""

    @property
    def albedo(self) -> Callable[[torch.Tensor], torch.Tensor]: ...

    @property
    def offset(self) -> torch.Tensor: ...

    def light(self, position: torch.Tensor, photo: torch.Tensor) -> torch.Tensor: ...

    def expose(self, radiance: torch.Tensor, photo: torch.Tensor) -> torch.Tensor: ...


def model_loss(model: Rendered, samples: Samples, terms: LossTerms) -> torch.Tensor:
    """|gamma(c) - I| + lambda |a - A'|, and the terms for runs without priors: a mean over samples, times their weights, and
    over channels.

    gamma is the sRGB encoding; albedo is compared in linear colour. The second term leaves out photos without a prior, and
    is weighted by the prior's own confidence.
    """
    albedo = model.albedo(samples.uv)
    weight = albedo.new_ones(()) if samples.weight is None else samples.weight[:, None]

    def mean(values: torch.Tensor) -> torch.Tensor:
        return (weight * values).mean()

    loss = albedo.new_zeros(())
    if terms.photometric:
        light = model.light(samples.position, samples.photo)
        colour = model.expose(albedo * light, samples.photo)
        loss = loss + mean((srgb_from_linear(colour) - samples.colour).abs())
        if terms.white_light > 0.0:
            log_light = torch.log(light + DARKNESS)
            loss = loss + terms.white_light * mean((log_light - log_light.mean(1, keepdim=True)).square())
        if terms.small_offset > 0.0:
            loss = loss + terms.small_offset * mean(model.offset[samples.photo].abs())
    if samples.prior is not None and terms.prior_weight > 0.0:
        prior, confidence = samples.prior[:, :3], samples.prior[:, 3:]
        known = torch.isfinite(prior) & torch.isfinite(confidence)
        difference = albedo - linear_from_srgb(torch.where(known, prior, 0.0))
        loss = loss + terms.prior_weight * mean(torch.where(known, confidence, 0.0) * difference.abs())
    return loss
