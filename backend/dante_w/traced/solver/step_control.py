"""Step control: accepts or rejects a step by the cost after it, and damps the next attempt after a rejection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dante_w.run.setbacks import LOWER, MOST, Setback


@dataclass(frozen=True)
class StepControlSettings:
    """Damping of the steps, and the rise of the cost that is accepted. Costs are as of `robust_cost`."""

    #: Damping of step n is this to the n-th: the model is less and less wrong.
    decay: float = 0.5
    #: Damping is no less than this.
    least_damping: float = 1e-3
    #: A cost above this multiple of the lowest so far, plus a margin, is taken for divergence.
    rise: float = 1.5
    #: The margin. Sound steps overshoot, too, when they first see all directions; later ones make good for it.
    margin: float = 0.5
    #: The margin of the last steps, after which nothing makes good.
    late_margin: float = 0.05
    #: How many steps are the last ones.
    late_steps: int = 3


@dataclass(frozen=True)
class StepResult:
    """What became of a step.

    Attributes:
        accepted: whether the state after it is kept; else the state before it comes back.
        damping: what is added to the damping of the next attempt, 0 if steps go well.
        reason: why it was rejected, a sentence without a full stop; empty if it was not.
    """

    accepted: bool
    damping: float
    reason: str = ""


@dataclass(frozen=True)
class StepControl:
    """The course of the steps so far.

    Attributes:
        lowest: lowest cost since the model changed last.
        rate: 1 at best, a tenth after a rejection, a hundredth after the second in a row.
        setbacks: the rejections, and the steps whose equations needed more damping.
        exhausted: whether there were so many that no further attempt is made.
    """

    lowest: float = math.inf
    rate: float = 1.0
    setbacks: tuple[Setback, ...] = ()
    exhausted: bool = False

    @property
    def damping(self) -> float:
        """What is added to the damping of the next attempt."""
        return 1.0 / self.rate - 1.0

    def restarted(self) -> StepControl:
        """After a change of the model: costs before it do not compare."""
        return replace(self, lowest=math.inf)

    def noting(self, step: int, reason: str, rate: float) -> StepControl:
        """With one more setback."""
        return replace(self, setbacks=(*self.setbacks, Setback(step, reason, rate)))

    def damped(self, step: int, factor: float) -> StepControl:
        """With a setback if the equations of a step had to be damped by a `factor` above 1."""
        if factor <= 1.0:
            return self
        return self.noting(step, "the equations had no sound solution", 1.0 / factor)


def damping_of(step: int, control: StepControl, settings: StepControlSettings) -> float:
    """The damping of a step, see `PcgSettings.relative_damping`."""
    return max(settings.decay**step, settings.least_damping) + control.damping


def judge(
    control: StepControl,
    step: int,
    steps: int,
    cost: float,
    unknowns: Sequence[np.ndarray],
    settings: StepControlSettings,
) -> tuple[StepControl, StepResult]:
    """Accept or reject the step that led to the state after `step` of `steps` steps.

    Args:
        cost: of that state. unknowns: its arrays, all of which must be finite.
    """
    late = steps - step <= settings.late_steps
    margin = settings.late_margin if late else settings.margin
    reason = _divergence(control.lowest, cost, unknowns, settings.rise, margin)
    if not reason:
        rate = min(control.rate / LOWER, 1.0)
        control = replace(control, lowest=min(control.lowest, cost), rate=rate)
        return control, StepResult(True, control.damping)
    if len(control.setbacks) >= MOST:
        control = replace(control, exhausted=True)
    else:
        rate = control.rate * LOWER
        control = replace(control.noting(step, reason, rate), rate=rate)
    return control, StepResult(False, control.damping, reason)


def robust_cost(weight: np.ndarray, error: np.ndarray) -> float:
    """Mean Cauchy loss of errors (M, 3), in units of the error that loses half its weight; weights (M, 3)."""
    total = max(float(weight.sum(dtype=np.float64)), 1e-9)
    return float((weight * np.log1p(error**2)).sum(dtype=np.float64)) / total


def _divergence(
    lowest: float, cost: float, unknowns: Sequence[np.ndarray], rise: float, margin: float
) -> str:
    if not math.isfinite(cost) or not all(bool(np.isfinite(each).all()) for each in unknowns):
        return "the cost or the lights were not finite"
    if cost > rise * lowest + margin:
        return f"the cost rose from {lowest:.3g} to {cost:.3g}"
    return ""
