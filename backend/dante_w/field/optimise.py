"""Fitting the model to the ray cache by stochastic gradient descent (paper, section 3.3 and Eq. 4, 6, 7)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field.batches import RUN, batches
from dante_w.field.cpu import step as fused
from dante_w.field.cpu.step import DARKNESS, FusedStep
from dante_w.field.cuda import grid as triton_grid
from dante_w.field.cuda.step import TritonStep
from dante_w.field.divergence import Course, Watch
from dante_w.field.fields import Model
from dante_w.field.fit_state import keep, resume
from dante_w.rays.ray_cache import RayCache, Samples
from dante_w.run import distributed
from dante_w.run.checkpoints import Checkpoints

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
    term, and a prior's own trust weighs it.
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
        prior, trust = samples.prior[:, :3], samples.prior[:, 3:]
        known = torch.isfinite(prior) & torch.isfinite(trust)
        difference = albedo - linear_from_srgb(torch.where(known, prior, 0.0))
        loss = loss + terms.prior_weight * mean(torch.where(known, trust, 0.0) * difference.abs())
    return loss


#: Takes a gradient and may replace it in place, as by the mean over several processes.
Share = Callable[[torch.Tensor], None]


class Step(Protocol):
    """One way to compute a step of the fit.

    `TorchStep` is plain torch, for any device, and the reference; `FusedStep` is numba, for the CPU; `TritonStep` for CUDA.
    """

    def gradients(
        self, samples: Samples
    ) -> tuple[float | torch.Tensor, Mapping[str, np.ndarray | torch.Tensor]]:
        """Loss of a batch, and its gradients by parameter name; valid until `update`, which has to follow."""
        ...

    def update(self, rate: float, share: Share | None = None) -> None:
        """Change the parameters by Adam, with the learning rate times `rate`, once `share`, if there is one, has seen every gradient."""
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

    def update(self, rate: float, share: Share | None = None) -> None:
        """See `Step`."""
        for parameter in self._chosen.values():
            if share and parameter.grad is not None:
                share(parameter.grad)
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate * rate
        self._optimiser.step()
        self._optimiser.zero_grad(set_to_none=True)


def step_for(
    model: Model, terms: LossTerms, parameters: Sequence[torch.nn.Parameter], learning_rate: float
) -> Step:
    """The fastest way for a model where it is."""
    fields = model.albedo, model.irradiance
    way: type[FusedStep | TritonStep | TorchStep] = TorchStep
    if all(fused.computes(field.grid, field.decoder) for field in fields):
        way = FusedStep
    elif all(triton_grid.computes(field.grid) for field in fields):
        way = TritonStep
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
    kept: Checkpoints | None = None,
    name: str = "",
    shared: bool = True,
) -> Course:
    """Minimise `model_loss` over random samples of the cache, in place; returns how it went.

    Steps after which the loss is not finite or has risen are taken back and done again at a lower rate, see `divergence`.

    Args:
        ranges: (R, 2), the samples to draw from; see `photo_ranges`.
        parameters: what to change; everything by default.
        kept: where the fit is kept under `name` every now and then, and gone on with if it was; not with several processes.
        shared: with several processes, each draws its part of a batch from photos of its own, and gradients are shared;
            see `distributed`. Else this process fits alone.
    """
    chosen = list(model.parameters()) if parameters is None else parameters
    way = step_for(model, terms, chosen, schedule.learning_rate)
    watch = Watch(chosen, schedule.steps)
    batch: int = schedule.batch
    share: Share | None = None
    if shared and distributed.world() > 1:
        batch, share, kept = max(batch // distributed.world(), RUN), distributed.mean, None
        ranges, seed = distributed.own(ranges), seed + distributed.SEEDS * distributed.rank()
    step, drawn = resume(kept, name, schedule.steps, chosen, way, watch) if kept else (0, 0)
    draws, losses = batches(ranges, batch, seed, drawn), []
    while step < schedule.steps:
        loss, _ = way.gradients(cache.samples(next(draws), model.offset.device))
        if step == 0:
            watch.start(_mean([loss], share))
        way.update(watch.rate * cosine(step, schedule.steps), share)
        step, drawn = step + 1, drawn + 1
        losses.append(loss)
        if watch.due(step):  # reading the losses waits for the device
            step, done = watch.look(step, _mean(losses, share)), step
            losses.clear()
            if step < done:
                way = step_for(model, terms, chosen, schedule.learning_rate)
            elif kept:
                keep(kept, name, step, drawn, schedule.steps, chosen, way, watch)
        progress(step, schedule.steps, watch.last)
    return Course(watch.first, watch.last, watch.setbacks)


def _mean(losses: Sequence[float | torch.Tensor], share: Share | None) -> float:
    """Of the losses of several batches, over all processes."""
    mean = torch.tensor([float(sum(losses)) / len(losses)], dtype=torch.float64)
    if share:
        share(mean)
    return float(mean)


def cosine(step: int, steps: int) -> float:
    """Learning rate factor from 1 down to `FINAL_RATE`."""
    return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * step / max(steps, 1)))


def photo_ranges(cache: RayCache, photos: np.ndarray) -> np.ndarray:
    """(R, 2): first sample and end of each photo's run; photos that see nothing are left out."""
    ranges = np.stack([cache.starts[photos], cache.starts[photos + 1]], axis=1)
    return ranges[ranges[:, 1] > ranges[:, 0]]


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
        squared += float(error.square().mean()) * error.numel()  # there is no float64 on Apple's GPUs
        count += error.numel()
    return -10.0 * math.log10(max(squared / max(count, 1), 1e-12))
