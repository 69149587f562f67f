"""A setback: what an iterative fit writes down when it went astray and was taken back."""

from __future__ import annotations

from dataclasses import dataclass

#: What the rate is multiplied with after a setback, and how many setbacks are borne.
LOWER, MOST = 0.1, 12


@dataclass(frozen=True)
class Setback:
    """A fit went astray before `step`: why, and the factor on the learning rate from then on."""

    step: int
    reason: str
    rate: float
