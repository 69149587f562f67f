"""Measurements beside the time they took: which are worth it, and all of them as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: The knob of rows that are presets as they come.
PRESET = "preset"


@dataclass(frozen=True)
class Row:
    """What was set to what, and its means over the objects: seconds of the whole command and of fitting alone,
    albedo PSNR in dB as it is and after one gain per channel."""

    knob: str
    label: str
    seconds: float
    fit_seconds: float
    psnr: float
    psnr_after_gain: float


def pareto_front(seconds: np.ndarray, accuracy: np.ndarray) -> np.ndarray:
    """(N,) bool: the points (N,) that no other beats, being no slower and no less accurate, and better in one.

    Equal points stand or fall together.

    >>> pareto_front(np.array([1.0, 2.0, 3.0, 3.0]), np.array([20.0, 19.0, 25.0, 25.0]))
    array([ True, False,  True,  True])

    Raises:
        ValueError: a value is NaN, which is neither faster nor slower than anything.
    """
    if np.isnan(seconds).any() or np.isnan(accuracy).any():
        raise ValueError("seconds and accuracy must be numbers, and some are NaN")
    order = np.lexsort((-accuracy, seconds))
    time, value = seconds[order], accuracy[order]
    first = np.searchsorted(time, time, side="left")  # of the points that take equally long, the best
    best_faster = np.maximum.accumulate(value)[first - 1]
    front = np.empty(len(time), bool)
    front[order] = (value == value[first]) & ((first == 0) | (value > best_faster))
    return front


def within_chance(seconds: np.ndarray, accuracy: np.ndarray, chance: float) -> np.ndarray:
    """(N,) bool: the points (N,) that would be on the front if they alone were more accurate by `chance`.

    >>> within_chance(np.array([1.0, 2.0, 3.0]), np.array([20.0, 19.95, 19.8]), 0.1)
    array([ True,  True, False])
    """
    points = np.arange(len(seconds))
    return np.array([pareto_front(seconds, accuracy + chance * (points == i))[i] for i in points], bool)


def table(rows: Sequence[Row], front: np.ndarray, near: np.ndarray, base: str) -> str:
    """The rows as a Markdown table; two columns compare them with the preset called `base`.

    Args:
        front, near: (N,) bool, the rows that are marked as being on the front, and as being so but for chance.
    """
    reference = next(row for row in rows if (row.knob, row.label) == (PRESET, base))
    lines = [
        f"| knob | value | seconds | of these fitting | PSNR | PSNR after gain | against {base}: s | dB | on the front |",
        "|---|---|---:|---:|---:|---:|---:|---:|:---:|",
    ]
    for row, on, almost in zip(rows, front, near, strict=True):
        slower, better = row.seconds - reference.seconds, row.psnr_after_gain - reference.psnr_after_gain
        cells = [row.knob, row.label, f"{row.seconds:.1f}", f"{row.fit_seconds:.1f}", f"{row.psnr:.2f}"]
        cells += [
            f"{row.psnr_after_gain:.2f}",
            f"{slower:+.1f}",
            f"{better:+.2f}",
            "yes" if on else "but for chance" if almost else "",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
