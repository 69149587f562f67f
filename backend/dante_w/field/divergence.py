"""Notices that a fit diverges, takes its steps back and lowers the learning rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch

from dante_w.run.setbacks import LOWER, MOST, Setback

#: Looks in the course of a fit, at least this many steps apart.
LOOKS, APART = 50, 10
#: A loss above this multiple of the lowest so far, plus this, is taken for divergence. Losses are means of L1 errors in sRGB.
ROSE = (1.5, 0.005)


@dataclass(frozen=True)
class Course:
    """How a fit went: the loss before its first step, the mean loss of the last steps, and setbacks."""

    first: float
    last: float
    setbacks: list[Setback]


@dataclass
class Watch:
    """Looks at a fit of `steps` steps every now and then. It keeps the parameters as they were when they were last found
    sound, on the CPU: as much memory as the parameters."""

    parameters: Sequence[torch.nn.Parameter]
    steps: int
    rate: float = 1.0
    setbacks: list[Setback] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.first = self.last = self.lowest = math.nan
        self._keep(0)

    def due(self, step: int) -> bool:
        """Whether to look after so many steps."""
        return step % max(self.steps // LOOKS, APART) == 0 or step == self.steps

    def start(self, loss: float) -> None:
        """Note the loss before the first step."""
        if math.isnan(self.first):
            self.first = self.last = self.lowest = loss

    def look(self, step: int, loss: float) -> int:
        """The step to go on from: `step` if all is well, else the one that the parameters were taken back to.

        Args:
            loss: mean since the last look.
        """
        reason = self._astray(loss)
        if reason is None:
            self.last, self.lowest = loss, min(self.lowest, loss)
            self._keep(step)
            return step
        with torch.no_grad():
            for parameter, kept in zip(self.parameters, self._kept, strict=True):
                parameter.copy_(kept)
        if len(self.setbacks) == MOST:
            return self.steps  # as good as it gets
        self.rate *= LOWER
        self.setbacks.append(Setback(step, reason, self.rate))
        return self._kept_at

    def restore(
        self, step: int, rate: float, first: float, last: float, lowest: float, setbacks: list[Setback]
    ) -> None:
        """Go on after `step` steps of a fit that was broken off; the parameters are back already."""
        self.rate, self.setbacks = rate, setbacks
        self.first, self.last, self.lowest = first, last, lowest
        self._keep(step)

    def _astray(self, loss: float) -> str | None:
        if not math.isfinite(loss) or not all(bool(p.isfinite().all()) for p in self.parameters):
            return "the loss or a parameter was not finite"
        factor, margin = ROSE
        if loss > factor * self.lowest + margin:
            return f"the loss rose from {self.lowest:.3g} to {loss:.3g}"
        return None

    def _keep(self, step: int) -> None:
        self._kept_at = step
        self._kept = [parameter.detach().to("cpu", copy=True) for parameter in self.parameters]
