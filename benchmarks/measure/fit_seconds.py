"""The table of seconds per unit of work, fitted to reports of finished runs; see `dante_w.estimate.seconds`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from dante_w.estimate.seconds import Probe, Work, traced_row
from scipy.optimize import nnls

#: Units of work that the seconds of a stage may grow with.
UNITS = {
    "rays": ("pixels", "samples"),
    "transfer": ("samples", "points"),
    "plan": ("observations", "lights x lights"),
    "lights": ("observations", "lights x lights"),
    "optimise": ("lookups",),
    "held-out": ("held_out_lookups",),
    "final pass": ("final_lookups",),
    "albedo": ("samples", "texels"),
    "bake": ("texels",),
    "write": ("texels",),
}
#: Seconds that are measured no better than to themselves: shorter stages weigh less.
NOTICEABLE = 0.3


def model_of(report: Mapping[str, Any]) -> str:
    """The row of the table that a run belongs to."""
    if "expected" not in report:
        return "average"
    return "field" if "device" in report else traced_row(report["settings"]["preset"])


def fit(reports: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The table. Seconds are first brought to one speed of the machine, by each run's own probe; errors are relative."""
    probes = [Probe(**report["probe"]) for report in reports]
    reference = median(probe.total() for probe in probes)
    runs = defaultdict(list)
    for report, probe in zip(reports, probes, strict=True):
        runs[model_of(report)].append((report, reference / probe.total()))
    arrays = median(probe.arrays / probe.total() for probe in probes) * reference
    table: dict[str, Any] = {
        "probe": {"arrays": round(arrays, 5), "matrices": round(reference - arrays, 5)},
        "typical": {},
        "seconds_per_unit": {},
    }
    for model in sorted(runs):
        stages = [stage for stage in UNITS if stage in runs[model][0][0]["seconds"]]
        table["seconds_per_unit"][model] = {stage: _per_unit(stage, runs[model]) for stage in stages}
    traced = [report for report in reports if model_of(report).startswith("traced")]
    for preset in sorted({report["settings"]["preset"] for report in traced}):
        table["typical"][preset] = _typical([each for each in traced if each["settings"]["preset"] == preset])
    return table


def _per_unit(stage: str, runs: Sequence[tuple[Mapping[str, Any], float]]) -> dict[str, float]:
    """Non-negative seconds of each unit of a stage."""
    seconds = np.array([report["seconds"][stage] * factor for report, factor in runs])
    work = [Work(**report["work"]) for report, _ in runs]
    amounts = np.array([[each.amount(unit) for unit in UNITS[stage]] for each in work])
    scale = np.maximum(amounts.max(axis=0), 1e-30)  # amounts differ by twelve orders
    weight = 1.0 / np.maximum(seconds, NOTICEABLE)
    found, _ = nnls(weight[:, None] * amounts / scale, weight * seconds)
    values = zip(UNITS[stage], found / scale, strict=True)
    return {unit: float(f"{value:.4g}") for unit, value in values if value > 0.0}


def _typical(reports: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Amounts of work that a run does not know before it has compared its photos."""
    views = [
        report["work"]["observations"] / report["work"]["points"] / report["photos"] for report in reports
    ]
    return {
        "points": round(median(report["work"]["points"] for report in reports)),
        "views_per_photo": round(median(views), 3),
        "lights": round(median(report["work"]["lights"] for report in reports)),
    }
