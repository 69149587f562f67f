"""Timing pieces of work against each other, on any device."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Stage:
    """`work` is timed; `before` is done each time without a clock."""

    work: Callable[[], object]
    before: Callable[[], object] = lambda: None


def measure(stages: Mapping[str, Stage], rounds: int, device: str = "cpu") -> dict[str, float]:
    """Median seconds of each stage, which take turns; once before without a clock. On a GPU they count until it is done."""
    seconds: dict[str, list[float]] = {name: [] for name in stages}
    for turn in range(rounds + 1):
        for name, stage in stages.items():
            print(f"\r   round {turn} of {rounds}: {name:20}", end="", file=sys.stderr, flush=True)
            stage.before()
            _wait(device)
            began = time.perf_counter()
            stage.work()
            _wait(device)
            if turn > 0:
                seconds[name].append(time.perf_counter() - began)
    print(file=sys.stderr)
    return {name: statistics.median(own) for name, own in seconds.items()}


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()
