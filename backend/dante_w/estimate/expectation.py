"""What a run will take and what it may reach, said before it begins.

Quality: what a preset reached where the truth is known; a run cannot know its own. `quality.json` has it, which
`python3 dev.py bench gigalit DIR` writes.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dante_w.contract.protocol import Expected, Quality
from dante_w.contract.text import duration

QUALITY = Path(__file__).with_name("quality.json")


@cache
def quality(model: str, preset: str) -> Quality | None:
    """Of a model of `contract.vocabulary.MODELS`, without priors, on the benchmark's objects; None: not measured."""
    figures = json.loads(QUALITY.read_text(encoding="utf-8"))[model].get(preset)
    return Quality(**figures) if figures else None


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
