"""A fit under way, so that a run that was killed can go on in the middle of it and come to the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from dante_w.field.cpu.step import FusedStep
from dante_w.field.divergence import Watch
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.setbacks import Setback


@dataclass(frozen=True)
class FitState:
    """After `step` steps and `drawn` batches: the parameters, Adam's `moments` after `updates`, what the watch knows.

    On a GPU, moments are not kept: there only a fit that has ended is of use.
    """

    step: int
    drawn: int
    parameters: list[np.ndarray]
    updates: int
    moments: list[np.ndarray]
    rate: float
    first: float
    last: float
    lowest: float
    setbacks: list[Setback]


def keep(
    kept: Checkpoints,
    name: str,
    step: int,
    drawn: int,
    steps: int,
    chosen: Sequence[torch.nn.Parameter],
    way: object,
    watch: Watch,
) -> None:
    """Keep the fit under `name`, where that is due and of use."""
    if not kept.due() or not (isinstance(way, FusedStep) or step == steps):
        return
    updates, moments = (way.updates, way.moments()) if isinstance(way, FusedStep) else (0, [])
    parameters = [parameter.detach().cpu().numpy() for parameter in chosen]
    told = watch.rate, watch.first, watch.last, watch.lowest, watch.setbacks
    kept.save(name, FitState(step, drawn, parameters, updates, moments, *told))


def resume(
    kept: Checkpoints, name: str, steps: int, chosen: Sequence[torch.nn.Parameter], way: object, watch: Watch
) -> tuple[int, int]:
    """Bring everything to where it was kept; returns the steps done and the batches drawn, 0 if nothing was kept."""
    state = kept.load(name, FitState)
    if state is None or not (isinstance(way, FusedStep) or state.step == steps):
        return 0, 0
    with torch.no_grad():
        for parameter, value in zip(chosen, state.parameters, strict=True):
            parameter.copy_(torch.from_numpy(np.array(value)))
    if isinstance(way, FusedStep):
        way.updates = state.updates
        for own, value in zip(way.moments(), state.moments, strict=True):
            own[...] = value
    watch.restore(state.step, state.rate, state.first, state.last, state.lowest, list(state.setbacks))
    return state.step, state.drawn
