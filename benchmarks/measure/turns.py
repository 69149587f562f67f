"""Pieces of work timed against each other, on any device."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Mapping

import torch


def median_seconds(
    works: Mapping[str, Callable[[], object]], rounds: int, device: str = "cpu"
) -> dict[str, float]:
    """Median seconds of each piece of work over `rounds`, in which they take turns; a first round is not timed.

    On a GPU the clock runs until it is done.
    """
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(rounds + 1):
        for name, work in works.items():
            print(f"\r   round {turn} of {rounds}: {name:20}", end="", file=sys.stderr, flush=True)
            _wait(device)
            start = time.perf_counter()
            work()
            _wait(device)
            if turn > 0:
                seconds[name].append(time.perf_counter() - start)
    print(file=sys.stderr)
    return {name: statistics.median(each) for name, each in seconds.items()}


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()
