"""Seconds that a run will take: its units of work times the seconds per unit that were measured on another machine, times how
much slower this one is.

`seconds.json` has the seconds per unit. `python3 dev.py bench time_estimate --fit SCENE...` writes it: it fits them to the
seconds and the work in the reports of finished runs. A first run after installing takes longer, since it compiles kernels.
"""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch

TABLE = Path(__file__).with_name("seconds.json")
#: Joins the amounts whose product is a unit of work, in the table.
TIMES = " x "
#: Stages of the paper's model that compute on its device.
FIT_STAGES = ("optimise", "held-out", "final pass")
#: Numbers sorted and exponentiated, and rows of the square matrices multiplied, by one round of the probe.
NUMBERS, ROWS = 1 << 18, 1024
#: Rounds, of which the median counts: other programs may come in between. So it takes about a third of a second on two cores of 2020.
ROUNDS = 9


@dataclass(frozen=True)
class Work:
    """How much a run has to do; what a model does not have is 0. Units of work are products of these amounts.

    Attributes:
        pixels: of all photos.
        samples: pixels that see the mesh.
        texels: of the texture.
        points: shading points.
        observations: of a shading point by a photo.
        lights: light clusters.
        lookups: in the hash tables of the paper's model by all steps of its fit; `final_lookups`, by those of its final pass; `held_out_lookups`,
            by scoring it on held-out photos.
    """

    pixels: float
    samples: float
    texels: float
    points: float = 0.0
    observations: float = 0.0
    lights: float = 0.0
    lookups: float = 0.0
    held_out_lookups: float = 0.0
    final_lookups: float = 0.0

    def amount(self, unit: str) -> float:
        """How many units there are of a kind, as the table names it.

        >>> Work(pixels=10.0, samples=4.0, texels=1.0, lights=3.0).amount("samples x lights x lights")
        36.0
        """
        return math.prod(float(getattr(self, name)) for name in unit.split(TIMES))


@dataclass(frozen=True)
class Probe:
    """Seconds of a fixed piece of work, which tell machines apart: of a round of array code, and of a matrix product on the device."""

    arrays: float
    matrices: float

    def total(self) -> float:
        return self.arrays + self.matrices


def measure(device: str = "cpu") -> Probe:
    """Time the fixed piece of work on this machine now; about 0.3 s."""
    numbers = np.random.default_rng(0).random(NUMBERS, np.float32)
    matrix = torch.full((ROWS, ROWS), 1.0 / ROWS, device=device)

    def sort() -> None:
        np.exp(numbers[np.argsort(numbers)])

    def multiply() -> None:
        float((matrix @ matrix).sum())  # waits for the device

    return Probe(_seconds(sort), _seconds(multiply))


def _seconds(work: Callable[[], None]) -> float:
    """Seconds of a round as usual, after one that starts threads."""
    work()
    seconds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


@cache
def read_table() -> dict[str, Any]:
    """The table: `probe`, `typical` amounts of work by preset, and `seconds_per_unit` by model, stage and unit."""
    table: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    return table


def traced_row(preset: str) -> str:
    """The row of traced light in the table: `draft` solves for lights in another way than all others."""
    return "traced draft" if preset == "draft" else "traced"


def with_typical_light(work: Work, preset: str, photos: int, most_views: int) -> Work:
    """`work` with the amounts of traced light that are only known once photos were compared, as other runs of the preset had them.

    Args:
        most_views: observations of one shading point at most.
    """
    typical = read_table()["typical"][preset]
    points = min(typical["points"], work.samples)
    views = min(typical["views_per_photo"] * photos, most_views)
    return replace(work, points=points, observations=points * views, lights=min(typical["lights"], photos))


def predict(
    work: Work, model: str, probe: Probe, device: str = "cpu", table: dict[str, Any] | None = None
) -> dict[str, float]:
    """Seconds of the stages to come, in their order.

    Args:
        model: a row of the table: that of `traced_row`, `field` or `average`.
        device: of the paper's model. The table has no GPU: steps on one are scaled by matrix products alone, which is rough.
        table: instead of the one that is there.
    """
    table = table or read_table()
    reference = Probe(**table["probe"])
    slowness = probe.total() / reference.total()
    fit_slowness = slowness if device == "cpu" else probe.matrices / reference.matrices
    seconds = {}
    for stage, units in table["seconds_per_unit"][model].items():
        factor = fit_slowness if stage in FIT_STAGES else slowness
        seconds[stage] = factor * sum(each * work.amount(unit) for unit, each in units.items())
    return {stage: value for stage, value in seconds.items() if value > 0.0}


def since_start() -> float:
    """Seconds since this process began: Python and torch take some to load."""
    return max(time.time() - psutil.Process().create_time(), 0.0)
