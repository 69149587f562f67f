"""Fitting the model to the ray cache by stochastic gradient descent (paper, section 3.3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from dante_w.field.batches import DRAWING, DrawingSettings, batches
from dante_w.field.cpu import step as cpu_step
from dante_w.field.cuda import grid as cuda_grid
from dante_w.field.cuda.step import CudaStep
from dante_w.field.divergence import DIVERGENCE, DivergenceGuard, DivergenceSettings, FitResult
from dante_w.field.fields import FieldModel
from dante_w.field.fit_state import SavePoint
from dante_w.field.step import AllReduce, Step, TorchStep
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import RayCache
from dante_w.run import distributed

#: Called after each step with (steps done, steps in all, a recent loss).
Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Schedule:
    """How long a fit runs, and its learning rate."""

    #: Steps of Adam.
    steps: int
    #: Samples a step.
    batch: int
    #: Adam's learning rate at the first step; the released reference's by default.
    learning_rate: float = 2e-3
    #: The learning rate falls along a cosine to this fraction.
    final_rate: float = 1.0 / 30.0

    def rate(self, step: int) -> float:
        """The factor on the learning rate at a step, from 1 down to `final_rate`."""
        half_turn = 0.5 * (1.0 + math.cos(math.pi * step / max(self.steps, 1)))
        return self.final_rate + (1.0 - self.final_rate) * half_turn


@dataclass(frozen=True)
class FitSettings:
    """What all fits have in common."""

    drawing: DrawingSettings = DRAWING
    divergence: DivergenceSettings = DIVERGENCE


FIT = FitSettings()


@dataclass(frozen=True)
class Problem:
    """What is fitted to what.

    Attributes:
        model: changed in place.
        cache, ranges: the samples from `ranges` (R, 2) of the cache; see `photo_ranges`.
        terms: of the loss.
        parameters: those that may change; all by default.
    """

    model: FieldModel
    cache: RayCache
    ranges: np.ndarray
    terms: LossTerms
    parameters: Sequence[torch.nn.Parameter] | None = None


def step_for(
    model: FieldModel, terms: LossTerms, parameters: Sequence[torch.nn.Parameter], learning_rate: float
) -> Step:
    """The fastest step for a model where it is."""
    fields = model.albedo, model.irradiance
    kind: type[cpu_step.CpuStep | CudaStep | TorchStep] = TorchStep
    if all(cpu_step.supports(field.grid, field.decoder) for field in fields):
        kind = cpu_step.CpuStep
    elif all(cuda_grid.supports(field.grid) for field in fields):
        kind = CudaStep
    return kind(model, terms, parameters, learning_rate)


def fit(
    problem: Problem,
    schedule: Schedule,
    seed: int,
    progress: Progress,
    settings: FitSettings = FIT,
    save_point: SavePoint | None = None,
    shared: bool = True,
) -> FitResult:
    """Minimise `model_loss` over random samples of the cache, in place; returns how it went.

    Steps after which the loss is not finite or has risen are taken back and done again at a lower rate, see `divergence`.

    Args:
        save_point: where the fit is kept every now and then, and gone on with if it was; not with several processes.
        shared: with several processes, each draws its part of a batch from photos of its own, and gradients are averaged;
            see `run.distributed`. Else this process fits alone.
    """
    model, terms, ranges, batch = problem.model, problem.terms, problem.ranges, schedule.batch
    parameters = list(model.parameters()) if problem.parameters is None else problem.parameters
    engine = step_for(model, terms, parameters, schedule.learning_rate)
    guard = DivergenceGuard(parameters, schedule.steps, settings.divergence)
    all_reduce: AllReduce | None = None
    if shared and distributed.world() > 1:
        batch = max(batch // distributed.world(), settings.drawing.run)
        all_reduce, save_point = distributed.mean, None
        ranges, seed = distributed.own(ranges), seed + distributed.SEEDS * distributed.rank()
    step = drawn = 0
    if save_point:
        step, drawn = save_point.resume(schedule.steps, parameters, engine, guard)
    draws, losses = batches(ranges, batch, seed, drawn, settings.drawing), []
    while step < schedule.steps:
        loss, _ = engine.gradients(problem.cache.samples(next(draws), model.offset.device))
        if step == 0:
            guard.start(_mean([loss], all_reduce))
        engine.update(guard.state.rate * schedule.rate(step), all_reduce)
        step, drawn = step + 1, drawn + 1
        losses.append(loss)
        if guard.due(step):  # reading the losses waits for the device
            step, done = guard.check(step, _mean(losses, all_reduce)), step
            losses.clear()
            if step < done:
                engine = step_for(model, terms, parameters, schedule.learning_rate)
            elif save_point:
                save_point.save((step, schedule.steps, drawn), parameters, engine, guard)
        progress(step, schedule.steps, guard.state.last)
    return FitResult(guard.state.first, guard.state.last, guard.state.setbacks)


def photo_ranges(cache: RayCache, photos: np.ndarray) -> np.ndarray:
    """(R, 2): first sample and end of each photo's run; photos that see nothing are left out."""
    ranges = np.stack([cache.starts[photos], cache.starts[photos + 1]], axis=1)
    return ranges[ranges[:, 1] > ranges[:, 0]]


def _mean(losses: Sequence[float | torch.Tensor], all_reduce: AllReduce | None) -> float:
    """Of the losses of several batches, over all processes."""
    mean = torch.tensor([float(sum(losses)) / len(losses)], dtype=torch.float64)
    if all_reduce:
        all_reduce(mean)
    return float(mean)
