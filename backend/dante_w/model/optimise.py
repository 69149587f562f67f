"""Fitting the model to the ray cache by stochastic gradient descent (paper, section 3.3 and Eq. 4, 6, 7)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from dante_w.color import linear_from_srgb, srgb_from_linear
from dante_w.model import fused
from dante_w.model.fields import Model
from dante_w.model.fused import DARKNESS, FusedStep
from dante_w.rays.ray_cache import RayCache, Samples

#: Samples drawn as one run of neighbours: they share table entries, so memory is touched less often.
RUN = 16
#: The learning rate falls along a cosine to this fraction.
FINAL_RATE = 1.0 / 30.0


@dataclass(frozen=True)
class LossTerms:
    """What is minimised.

    photometric: Eq. 6 on or off. prior_weight: lambda of Eq. 7.
    white_light, small_offset: weights of two terms that are not the paper's, for runs without priors. Photos
    leave open whether a broad tint belongs to the surface or to its light, and whether b_k takes up haze or
    colour; these say light is nearly white and b_k nearly 0 where the photos do not say otherwise.
    """

    photometric: bool = True
    prior_weight: float = 1.0
    white_light: float = 0.0
    small_offset: float = 0.0


@dataclass(frozen=True)
class Schedule:
    steps: int
    batch: int
    learning_rate: float = 2e-3


#: Called after each step with (steps done, steps in all, a recent loss).
Progress = Callable[[int, int, float], None]


def model_loss(model: Model, samples: Samples, terms: LossTerms) -> torch.Tensor:
    """|gamma(c) - I| + lambda |a - A'| as a mean over samples, times their weights, and channels, and the terms for runs
    without priors.

    gamma is the sRGB transfer; albedo is compared in linear colour. Photos without a prior leave out the second
    term.
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
        known = torch.isfinite(samples.prior)
        difference = albedo - linear_from_srgb(torch.where(known, samples.prior, 0.0))
        loss = loss + terms.prior_weight * mean(torch.where(known, difference, 0.0).abs())
    return loss


class Step(Protocol):
    """One way to compute a step of the fit.

    `TorchStep` is plain torch, for any device, and the reference; `FusedStep` is numba, for the CPU.
    """

    def gradients(
        self, samples: Samples
    ) -> tuple[float | torch.Tensor, Mapping[str, np.ndarray | torch.Tensor]]:
        """Loss of a batch, and its gradients by parameter name; valid until `update`, which has to follow."""
        ...

    def update(self, rate: float) -> None:
        """Change the parameters by Adam, with the learning rate times `rate`."""
        ...


class TorchStep:
    """`Step` by autograd and `torch.optim.Adam`."""

    def __init__(
        self, model: Model, terms: LossTerms, parameters: Sequence[torch.nn.Parameter], learning_rate: float
    ) -> None:
        self._model, self._terms, self._learning_rate = model, terms, learning_rate
        chosen = {id(parameter) for parameter in parameters}
        self._chosen = {name: p for name, p in model.named_parameters() if id(p) in chosen}
        on_mps = model.offset.device.type == "mps"
        self._optimiser = torch.optim.Adam(
            self._chosen.values(), lr=learning_rate, eps=1e-15, fused=not on_mps
        )

    def gradients(self, samples: Samples) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """See `Step`; parameters that the loss does not depend on are left out."""
        loss = model_loss(self._model, samples, self._terms)
        found = torch.autograd.grad(loss, list(self._chosen.values()), allow_unused=True)
        for parameter, gradient in zip(self._chosen.values(), found, strict=True):
            parameter.grad = gradient
        return loss.detach(), {name: p.grad for name, p in self._chosen.items() if p.grad is not None}

    def update(self, rate: float) -> None:
        """See `Step`."""
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate * rate
        self._optimiser.step()
        self._optimiser.zero_grad(set_to_none=True)


def step_for(
    model: Model, terms: LossTerms, parameters: Sequence[torch.nn.Parameter], learning_rate: float
) -> Step:
    """The fastest way for a model where it is."""
    fields = model.albedo, model.irradiance
    way = FusedStep if all(fused.computes(field.grid, field.decoder) for field in fields) else TorchStep
    return way(model, terms, parameters, learning_rate)


def fit(
    model: Model,
    cache: RayCache,
    ranges: np.ndarray,
    terms: LossTerms,
    schedule: Schedule,
    seed: int,
    progress: Progress,
    parameters: list[torch.nn.Parameter] | None = None,
) -> None:
    """Minimise `model_loss` over random samples of the cache, in place.

    Args:
        ranges: (R, 2), the samples to draw from; see `photo_ranges`.
        parameters: what to change; everything by default.
    """
    chosen = list(model.parameters()) if parameters is None else parameters
    way = step_for(model, terms, chosen, schedule.learning_rate)
    draws = batches(ranges, schedule.batch, seed)
    latest = math.nan
    for step in range(schedule.steps):
        loss, _ = way.gradients(cache.samples(next(draws), model.offset.device))
        way.update(cosine(step, schedule.steps))
        if step % 10 == 0:  # reading the loss waits for the device
            latest = float(loss)
        progress(step + 1, schedule.steps, latest)


def cosine(step: int, steps: int) -> float:
    """Learning rate factor from 1 down to `FINAL_RATE`."""
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * step / max(steps, 1)))


def photo_ranges(cache: RayCache, photos: np.ndarray) -> np.ndarray:
    """(R, 2): first sample and end of each photo's run; photos that see nothing are left out."""
    ranges = np.stack([cache.starts[photos], cache.starts[photos + 1]], axis=1)
    return ranges[ranges[:, 1] > ranges[:, 0]]


def batches(ranges: np.ndarray, batch: int, seed: int) -> Iterator[np.ndarray]:
    """Endless random batches of sample indices from ranges (R, 2) of the cache, in runs of `RUN` neighbours.

    Every sample is drawn with the same probability. With fewer samples than a batch, samples repeat.
    """
    generator = np.random.default_rng(seed)
    lengths = ranges[:, 1] - ranges[:, 0]
    ends = np.cumsum(lengths)
    within = np.arange(RUN)
    runs = max(batch // RUN, 1)
    while True:
        ranks = generator.integers(0, ends[-1], runs)
        which = np.searchsorted(ends, ranks, side="right")
        length = lengths[which]
        # a run that reaches the end of its range goes on at its start: no sample is drawn less often
        place = (ranks - (ends[which] - length))[:, None] + within
        yield (ranges[which, :1] + place % length[:, None]).reshape(-1)


@torch.no_grad()
def psnr(model: Model, cache: RayCache, index: np.ndarray) -> float:
    """PSNR in dB of re-rendered sRGB colours against the photos at the given samples."""
    device = model.offset.device
    squared, count = 0.0, 0
    for start in range(0, len(index), 1 << 17):
        samples = cache.samples(index[start : start + (1 << 17)], device)
        light = model.light(samples.position, samples.photo)
        colour = model.expose(model.albedo(samples.uv) * light, samples.photo)
        error = srgb_from_linear(colour).clamp(0.0, 1.0) - samples.colour.clamp(0.0, 1.0)
        squared += float(error.double().square().sum())
        count += error.numel()
    return -10.0 * math.log10(max(squared / max(count, 1), 1e-12))
