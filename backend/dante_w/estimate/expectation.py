"""What a run will take and what it may reach, said before it begins.

Seconds: the pace that `pace.measure` finds, times the work to come. What lies behind at that moment, the start and the
scene, is counted as it was. `python3 dev.py bench time_estimate SCENE...` measures the error.

Quality: what a preset reached where the truth is known. A run cannot know its own.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import psutil

from dante_w.contract.protocol import Expected, Quality
from dante_w.contract.text import duration
from dante_w.estimate.pace import Pace

#: Of traced light and of the paper's field, without priors, on four objects: `python3 dev.py bench gigalit DIR`. None: not
#: measured.
QUALITY: dict[str, dict[str, Quality | None]] = {
    "traced": {
        "draft": Quality(29.6, 27.1, 32.4),
        "standard": Quality(30.8, 28.3, 34.2),
        "high": Quality(31.1, 27.8, 34.5),
        "paper": None,
    },
    "field": {
        "draft": Quality(22.9, 20.1, 24.1),
        "standard": Quality(24.3, 20.8, 27.2),
        "high": None,
        "paper": None,
    },
}


@dataclass(frozen=True)
class Work:
    """How much is to be done: photos, their pixels and those of held-out ones, texels, and steps of either pass."""

    photos: int
    pixels: int
    texels: int
    held_out_pixels: int = 0
    held_out_steps: int = 0
    steps: int = 0
    final_steps: int = 0


@dataclass(frozen=True)
class Expectation:
    """Seconds of each stage, those behind included, and the quality that the preset reached elsewhere."""

    seconds: dict[str, float]
    quality: Quality | None

    def message(self) -> Expected:
        """As it is said: stages are rounded before they are added, so that they add up."""
        seconds = {stage: round(value, 3) for stage, value in self.seconds.items()}
        return Expected(seconds, round(sum(seconds.values()), 3), self.quality)

    def as_dict(self) -> dict[str, Any]:
        """As in report.json."""
        return asdict(self.message())

    def sentence(self, preset: str, priors: bool) -> str:
        """For people, before the work begins."""
        begin = f"{preset}: about {duration(sum(self.seconds.values()))} here; "
        if priors:
            return begin + "how near the albedo comes to the truth depends on the priors"
        if self.quality is None:
            return begin + "how near the albedo comes to the truth is not measured for these settings"
        reached = f"{self.quality.mean:.1f} dB ({self.quality.lowest:.1f} to {self.quality.highest:.1f})"
        where = "on four rendered test objects without priors this preset reached"
        return f"{begin}{where} {reached}, albedo PSNR after one gain per channel"


def since_start() -> float:
    """Seconds since this process began: Python, torch and the kernels take some to load."""
    return max(time.time() - psutil.Process().create_time(), 0.0)


def predict(pace: Pace, work: Work) -> dict[str, float]:
    """Seconds of the stages to come, in their order."""
    reading = pace.read * work.pixels
    casting = pace.ray * pace.foreground * work.pixels
    # two threads read ahead of the rays; nothing is ahead of the first photo
    rays = pace.mesh + reading / max(work.photos, 1) + max(reading / 2.0, casting)
    held_out = 0.0
    if work.held_out_pixels:
        half = 0.5 * pace.foreground * work.held_out_pixels  # the other half is fitted to
        held_out = work.held_out_steps * pace.photo_step + half * pace.render
    seconds = {
        "rays": rays,
        "optimise": work.steps * pace.step,
        "held-out": held_out,
        "final pass": work.final_steps * pace.step,
        "bake": work.texels * pace.bake,
        "write": work.texels * pace.write,
    }
    return {stage: value for stage, value in seconds.items() if value > 0.0}
