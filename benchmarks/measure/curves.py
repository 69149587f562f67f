"""Accuracy against time as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no window, no display
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import Bbox
from measure.pareto import PRESET, Row

MARKS = "osv^<>DpPXh*"
#: Where a label may stand, in points from its dot: first to where faster and better would be, as that side of the
#: front is empty, then to the other side, each time farther out.
PLACES = [
    (radius * np.cos(np.radians(angle)), radius * np.sin(np.radians(angle)))
    for radius in (9.0, 20.0, 34.0, 50.0, 68.0, 88.0)
    for angle in (145.0, 115.0, 165.0, -35.0, -60.0)
]


def draw(file: Path, rows: Sequence[Row], front: np.ndarray, title: str) -> None:
    """Write a PNG: every dot in its knob's colour, a line along each knob, presets large, the front as steps.

    Args:
        rows: (N,) measurements; those with knob `PRESET` are the presets.
        front: (N,) bool, the rows on the Pareto front; these get labels.
    """
    figure, axes = plt.subplots(figsize=(9.2, 6.0), dpi=110, layout="constrained")
    _draw_front(axes, [row for row, on in zip(rows, front, strict=True) if on])
    knobs = [knob for knob in dict.fromkeys(row.knob for row in rows) if knob != PRESET]
    colours = plt.get_cmap("tab20")(np.r_[0:20:2, 1:20:2])
    for index, knob in enumerate(knobs):
        own = sorted((row for row in rows if row.knob == knob), key=lambda row: row.seconds)
        x, y = [row.seconds for row in own], [row.psnr_after_gain for row in own]
        style = {"color": colours[index % 20], "marker": MARKS[index % len(MARKS)], "markersize": 5.5}
        axes.plot(x, y, linewidth=0.8, alpha=0.85, label=knob, **style)
    presets = [row for row in rows if row.knob == PRESET]
    if presets:
        x, y = [row.seconds for row in presets], [row.psnr_after_gain for row in presets]
        axes.scatter(x, y, s=190, marker="*", color="black", zorder=5, label="presets")
    axes.set_xscale("log")
    axes.set(
        xlabel="seconds from start to written texture",
        ylabel="albedo PSNR after one gain per channel, dB",
        title=title,
    )
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.margins(0.1, 0.12)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.legend(loc="lower right", fontsize=8, framealpha=0.9)
    on_front = {(row.seconds, row.psnr_after_gain): row for row, on in zip(rows, front, strict=True) if on}
    on_front |= {
        (row.seconds, row.psnr_after_gain): row for row in presets
    }  # standard is a value of every knob
    _label(axes, list(on_front.values()))
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    plt.close(figure)


def _draw_front(axes: Axes, front: Sequence[Row]) -> None:
    """The best accuracy that is to be had by each time, as a step line."""
    steps = sorted((row.seconds, row.psnr_after_gain) for row in front)
    if steps:
        x, y = zip(*steps, strict=True)
        axes.plot(x, y, drawstyle="steps-post", color="0.72", linewidth=3.5, zorder=0, label="Pareto front")


def _label(axes: Axes, rows: Sequence[Row]) -> None:
    """Write each row's label at the first of `PLACES` where it covers no other label."""
    axes.figure.draw_without_rendering()  # axes get their size only now
    renderer = axes.figure.canvas.get_renderer()
    taken: list[Bbox] = []
    for row in sorted(rows, key=lambda row: row.knob != PRESET):
        preset = row.knob == PRESET
        words = row.label if preset else f"{row.knob} {row.label}"
        for x, y in PLACES:
            text = axes.annotate(
                words,
                (row.seconds, row.psnr_after_gain),
                xytext=(x, y),
                textcoords="offset points",
                ha="right" if x < 0 else "left",
                fontsize=10 if preset else 8,
                fontweight="bold" if preset else "normal",
                arrowprops={"arrowstyle": "-", "color": "0.5", "linewidth": 0.5},
                zorder=6,
            )
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer).padded(1.0)
            if (x, y) == PLACES[-1] or not any(box.overlaps(other) for other in taken):
                break
            text.remove()
        taken.append(box)
