"""Learning rates and lambda from 0 to a million, and very long fits in tiny batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from dante_w.model.optimise import Schedule

from extremes.judge import MODELS, alike, as_good, between, refused, texel_centres, tried, unspoilt
from extremes.row import Row
from extremes.world import FIELD, TINY, Outcome, albedo_at, make, with_priors

FAMILY = "fitting"
LONG = Schedule(steps=20_000, batch=64, learning_rate=1e-2)


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    own = unspoilt("field")
    progress("learning rate 0")
    still = replace(TINY, schedule=replace(TINY.schedule, learning_rate=0.0))
    yield refused(FAMILY, "learning rate 0", tried(base, *FIELD, preset=still), "told nothing", code=1)
    for rate in (1.0, 1e3, 1e6, np.inf):
        progress(f"learning rate {rate:g}")
        wild = replace(TINY, schedule=replace(TINY.schedule, learning_rate=rate))
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
        tried(base, *FIELD, preset=replace(TINY, schedule=LONG)),
        own,
        3.0,
    )
    known = with_priors(base)
    for model, options in MODELS.items():
        progress(f"lambda, {model}")
        without = tried(known, *options, "--lambda", "0")
        yield alike(FAMILY, f"true priors, lambda 0, {model}", without, unspoilt(model), 60.0)
        for weight in ("1e-6", "1", "1e6"):
            yield _told(
                f"true priors, lambda {weight}, {model}", tried(known, *options, "--lambda", weight), weight
            )


def _told(name: str, outcome: Outcome, weight: str) -> Row:
    least = 10.0 if weight == "1e-6" else 25.0  # so weak a prior tells the level at most
    bound = f"PSNR at least {least:g} dB to the truth as it is"
    if outcome.code or outcome.albedo is None:
        return Row(name, FAMILY, f"exit {outcome.code}", bound, False, outcome.message)
    value = between(outcome, replace(outcome, albedo=albedo_at(texel_centres(len(outcome.albedo)))))
    return Row(
        name, FAMILY, f"{value:.1f} dB", bound, value >= least and not outcome.unsound, outcome.unsound
    )
