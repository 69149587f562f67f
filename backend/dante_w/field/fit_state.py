"""A fit under way, so that a run that was killed can go on in the middle of it and come to the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from dante_w.field.cpu.step import CpuStep
from dante_w.field.divergence import DivergenceGuard, GuardState
from dante_w.field.step import Step
from dante_w.run.checkpoints import Checkpoints


@dataclass(frozen=True)
class FitState:
    """A fit after `step` steps and `drawn` batches: the parameters, Adam's `moments` after `updates`, and the guard's state.

    On a GPU moments are not kept: there only a fit that has ended is of use.
    """

    step: int
    drawn: int
    parameters: list[np.ndarray]
    updates: int
    moments: list[np.ndarray]
    guard: GuardState


@dataclass(frozen=True)
class SavePoint:
    """Keeps one fit under a name among the run's checkpoints."""

    checkpoints: Checkpoints
    name: str

    def save(
        self,
        progress: tuple[int, int, int],
        parameters: Sequence[torch.nn.Parameter],
        engine: Step,
        guard: DivergenceGuard,
    ) -> None:
        """Keep the fit where that is due and of use.

        Args:
            progress: steps done, steps in all, and batches drawn.
        """
        step, steps, drawn = progress
        if not self.checkpoints.due() or not (isinstance(engine, CpuStep) or step == steps):
            return
        updates, moments = (engine.updates, engine.moments()) if isinstance(engine, CpuStep) else (0, [])
        values = [parameter.detach().cpu().numpy() for parameter in parameters]
        self.checkpoints.save(self.name, FitState(step, drawn, values, updates, moments, guard.state))

    def resume(
        self, steps: int, parameters: Sequence[torch.nn.Parameter], engine: Step, guard: DivergenceGuard
    ) -> tuple[int, int]:
        """Bring everything to where it was kept; returns the steps done and the batches drawn, 0 if nothing was kept."""
        state = self.checkpoints.load(self.name, FitState)
        if state is None or not (isinstance(engine, CpuStep) or state.step == steps):
            return 0, 0
        with torch.no_grad():
            for parameter, value in zip(parameters, state.parameters, strict=True):
                parameter.copy_(torch.from_numpy(np.array(value)))
        if isinstance(engine, CpuStep):
            engine.updates = state.updates
            for moment, value in zip(engine.moments(), state.moments, strict=True):
                moment[...] = value
        guard.restore(state.step, state.guard)
        return state.step, state.drawn
