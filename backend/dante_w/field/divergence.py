"""Notices that a fit diverges, takes its steps back and lowers the learning rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from dante_w.run.setbacks import LOWER, MOST, Setback


@dataclass(frozen=True)
class DivergenceSettings:
    """When a fit is looked at, and what is taken for divergence. Losses are means of L1 errors in sRGB."""

    #: How often a fit is looked at: reading the loss waits for the device.
    checks: int = 50
    #: Steps between two checks, at least: the mean loss of fewer steps is too noisy.
    apart: int = 10
    #: A loss above this multiple of the lowest so far, plus the margin, is taken for divergence.
    rise: float = 1.5
    #: That margin, so that a loss near 0 may double.
    margin: float = 0.005
    #: A fit that leaves more than this part of the loss that it began with ...
    unexplained: float = 0.9
    #: ... and more than this loss has explained nothing.
    small_loss: float = 0.05


DIVERGENCE = DivergenceSettings()


@dataclass(frozen=True)
class FitResult:
    """How a fit went: the loss before its first step, the mean loss of the last steps, and setbacks."""

    first_loss: float
    last_loss: float
    setbacks: list[Setback]

    def failed(self, settings: DivergenceSettings = DIVERGENCE) -> bool:
        """Whether the fit diverged or explained nothing."""
        most = max(settings.unexplained * self.first_loss, settings.small_loss)
        return not math.isfinite(self.last_loss) or self.last_loss > most


@dataclass(frozen=True)
class GuardState:
    """The factor on the learning rate, losses (`first`, `last`, `lowest`), and the setbacks so far."""

    rate: float
    first: float
    last: float
    lowest: float
    setbacks: list[Setback]


class DivergenceGuard:
    """Checks a fit of `steps` steps every now and then. It keeps the parameters of the last check that they passed, on the
    CPU: as much memory as the parameters."""

    def __init__(
        self, parameters: Sequence[torch.nn.Parameter], steps: int, settings: DivergenceSettings = DIVERGENCE
    ) -> None:
        self._parameters, self._steps, self._settings = parameters, steps, settings
        self.state = GuardState(1.0, math.nan, math.nan, math.nan, [])
        self._keep(0)

    def due(self, step: int) -> bool:
        """Whether to check after so many steps."""
        interval = max(self._steps // self._settings.checks, self._settings.apart)
        return step % interval == 0 or step == self._steps

    def start(self, loss: float) -> None:
        """Note the loss before the first step."""
        if math.isnan(self.state.first):
            self.state = replace(self.state, first=loss, last=loss, lowest=loss)

    def check(self, step: int, loss: float) -> int:
        """The step to go on from: `step` if all is well, else the one that the parameters were taken back to.

        Args:
            loss: mean since the last check.
        """
        state = self.state
        reason = self._failure(loss)
        if reason is None:
            self.state = replace(state, last=loss, lowest=min(state.lowest, loss))
            self._keep(step)
            return step
        with torch.no_grad():
            for parameter, kept in zip(self._parameters, self._kept, strict=True):
                parameter.copy_(kept)
        if len(state.setbacks) == MOST:
            return self._steps  # as good as it gets
        rate = state.rate * LOWER
        self.state = replace(state, rate=rate, setbacks=[*state.setbacks, Setback(step, reason, rate)])
        return self._kept_step

    def restore(self, step: int, state: GuardState) -> None:
        """Go on after `step` steps of a fit that was broken off; the parameters are back already."""
        self.state = state
        self._keep(step)

    def _failure(self, loss: float) -> str | None:
        if not math.isfinite(loss) or not all(bool(p.isfinite().all()) for p in self._parameters):
            return "the loss or a parameter was not finite"
        if loss > self._settings.rise * self.state.lowest + self._settings.margin:
            return f"the loss rose from {self.state.lowest:.3g} to {loss:.3g}"
        return None

    def _keep(self, step: int) -> None:
        self._kept_step = step
        self._kept = [parameter.detach().to("cpu", copy=True) for parameter in self._parameters]
