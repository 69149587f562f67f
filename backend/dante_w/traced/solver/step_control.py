"""Notices that a Gauss-Newton step on lights went astray, so that it is taken back and taken again with more damping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dante_w.run.setbacks import LOWER, MOST, Setback

#: A cost above this multiple of the lowest so far, plus a margin, is taken for divergence. Sound steps overshoot, too: on
#: four rendered objects by up to 0.32, when they first see all directions, and later ones make good for it. Where no more
#: than `LATE` are left, it rose by 0.004 at most.
ROSE, MARGIN, LATE_MARGIN, LATE = 1.5, 0.5, 0.05, 3


@dataclass(frozen=True)
class Course:
    """How the steps went: the `lowest` cost since what is modelled changed last, the `rate` (1 at best, see `harder`),
    the setbacks, and whether there were so many that it is better to end where it was sound."""

    lowest: float = math.inf
    rate: float = 1.0
    setbacks: tuple[Setback, ...] = ()
    hopeless: bool = False

    @property
    def harder(self) -> float:
        """What is added to a step's damping."""
        return 1.0 / self.rate - 1.0


def robust_cost(weight: np.ndarray, error: np.ndarray) -> float:
    """Mean robust (Cauchy) cost of errors (M, 3), in units of the error that loses half its weight; weights (M, 3)."""
    total = max(float(weight.sum(dtype=np.float64)), 1e-9)
    return float((weight * np.log1p(error**2)).sum(dtype=np.float64)) / total


def look(
    course: Course, step: int, steps: int, cost: float, found: Sequence[np.ndarray]
) -> tuple[Course, bool]:
    """Whether the step before `step` of `steps` was sound, by the cost after it and by all that was `found` being finite.
    The rate falls if not, and else returns to 1."""
    late = steps - step <= LATE
    reason = _astray(course.lowest, cost, found, LATE_MARGIN if late else MARGIN)
    if reason is None:
        return replace(course, lowest=min(course.lowest, cost), rate=min(course.rate / LOWER, 1.0)), True
    if len(course.setbacks) >= MOST:
        return replace(course, hopeless=True), False
    lower = course.rate * LOWER
    return replace(noted(course, step, reason, lower), rate=lower), False


def noted(course: Course, step: int, reason: str, rate: float) -> Course:
    """With one more setback."""
    return replace(course, setbacks=(*course.setbacks, Setback(step, reason, rate)))


def _astray(lowest: float, cost: float, found: Sequence[np.ndarray], margin: float) -> str | None:
    if not math.isfinite(cost) or not all(bool(np.isfinite(each).all()) for each in found):
        return "the cost or the lights were not finite"
    if cost > ROSE * lowest + margin:
        return f"the cost rose from {lowest:.3g} to {cost:.3g}"
    return None
