"""Learning rates and lambda from 0 to a million, very long fits in tiny batches, and steps on lights that go astray."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from dante_w.field.optimise import Schedule
from dante_w.presets import Preset
from dante_w.traced.solver import levenberg_marquardt
from dante_w.traced.solver.normal_equations import Step, gauss_newton_step

from extremes.judge import MODELS, alike, as_good, between, refused, texel_centres, tried, unspoilt
from extremes.row import Row
from extremes.world import FIELD, TINY, TRACED, Outcome, World, albedo_at, make, with_priors

FAMILY = "fitting"
#: What the sixth step on lights adds to the exposures of the photos in turn, and the plan's parts, lest it tries them.
ASTRAY = {"not a number": (np.nan, np.nan), "astray by 6 stops": (4.2, 0.0)}
PLANNED = (*TRACED, "--model", "groups", "--model", "exposures")
LONG = Schedule(steps=20_000, batch=64, learning_rate=1e-2)


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    own = unspoilt("field")
    progress("learning rate 0")
    still = scheduled(replace(TINY.field.schedule, learning_rate=0.0))
    yield refused(FAMILY, "learning rate 0", tried(base, *FIELD, preset=still), "explained nothing", code=1)
    for rate in (1.0, 1e3, 1e6, np.inf):
        progress(f"learning rate {rate:g}")
        wild = scheduled(replace(TINY.field.schedule, learning_rate=rate))
        outcome = tried(base, *FIELD, preset=wild)
        if rate == np.inf:
            yield refused(FAMILY, "learning rate infinite", outcome, "diverged", code=1)
            continue
        setbacks = outcome.report.get("setbacks", {}).get("optimise", [])
        note = f"setbacks in the report: {len(setbacks)}, the last at {setbacks[-1]['rate']:.0e} of the rate" if setbacks else "no setback"  # fmt: skip
        row = as_good(FAMILY, f"learning rate {rate:g}", outcome, own, 3.0, note)
        yield row._replace(holds=row.holds and bool(setbacks), bound=row.bound + "; setbacks are reported")
    progress("a long fit")
    yield as_good(
        FAMILY,
        f"{LONG.steps:,} steps of {LONG.batch} samples",
        tried(base, *FIELD, preset=scheduled(LONG)),
        own,
        3.0,
    )
    planned = tried(base, *PLANNED)
    for how, shift in ASTRAY.items():
        progress(f"a step on lights {how}")
        yield _astray(f"a step on lights {how}, traced", base, planned, shift)
    known = with_priors(base)
    for model, options in MODELS.items():
        progress(f"lambda, {model}")
        without = tried(known, *options, "--lambda", "0")
        yield alike(FAMILY, f"true priors, lambda 0, {model}", without, unspoilt(model), 60.0)
        for weight in ("1e-6", "1", "1e6"):
            yield _told(
                f"true priors, lambda {weight}, {model}", tried(known, *options, "--lambda", weight), weight
            )


def scheduled(schedule: Schedule) -> Preset:
    """`TINY` with another main pass."""
    return replace(TINY, field=replace(TINY.field, schedule=schedule))


def _astray(name: str, base: World, planned: Outcome, shift: tuple[float, float]) -> Row:
    turns = []

    def struck(*arguments: Any) -> Step:
        step = gauss_newton_step(*arguments)
        turns.append(1)
        if len(turns) != 6:
            return step
        exposure = step.log_exposure + np.resize(shift, len(step.log_exposure))
        return replace(step, log_exposure=exposure)

    with mock.patch.object(levenberg_marquardt, "gauss_newton_step", struck):
        outcome = tried(base, *PLANNED)
    setbacks = outcome.report.get("setbacks", {}).get("lights", [])
    note = "; ".join(f"{each['reason']}, rate {each['rate']:g}" for each in setbacks) or "no setback"
    row = as_good(FAMILY, name, outcome, planned, 1.0, note)
    return row._replace(holds=row.holds and len(setbacks) == 1, bound=row.bound + "; it is reported")


def _told(name: str, outcome: Outcome, weight: str) -> Row:
    least = 10.0 if weight == "1e-6" else 25.0  # so weak a prior tells the level at most
    bound = f"PSNR at least {least:g} dB to the truth as it is"
    if outcome.code or outcome.albedo is None:
        return Row(name, FAMILY, f"exit {outcome.code}", bound, False, outcome.message)
    value = between(outcome, replace(outcome, albedo=albedo_at(texel_centres(len(outcome.albedo)))))
    return Row(
        name, FAMILY, f"{value:.1f} dB", bound, value >= least and not outcome.unsound, outcome.unsound
    )
