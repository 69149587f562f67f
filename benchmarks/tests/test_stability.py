"""The stability suite tells what holds from what does not."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import stability
from extremes.judge import alike, as_good, finite, refused, texel_centres
from extremes.row import Row
from extremes.world import FIELD, Outcome, albedo_at, make, recover, write
from measure.machine import provenance

TRUTH = albedo_at(texel_centres(32))
SEEN = np.ones((32, 32), bool)
GOOD = Outcome(0, "", {}, TRUTH, SEEN)


def test_a_texture_that_is_off_or_was_not_finite_on_the_way_does_not_hold() -> None:
    off = replace(GOOD, albedo=TRUTH + np.random.default_rng(0).normal(0.0, 0.05, TRUTH.shape))
    assert alike("f", "n", GOOD, GOOD, 90.0).holds
    assert not alike("f", "n", off, GOOD, 40.0).holds
    assert as_good("f", "n", replace(off, albedo=0.5 * TRUTH), GOOD, 1.0).holds  # after gain
    assert not as_good("f", "n", off, GOOD, 1.0).holds
    for judged in (
        alike("f", "n", replace(GOOD, unsound="loss"), GOOD, 90.0),
        finite("f", "n", replace(GOOD, unsound="loss")),
    ):
        assert not judged.holds and "loss" in judged.measured


def test_grey_is_no_result_and_neither_is_an_error() -> None:
    grey = replace(GOOD, albedo=np.full_like(TRUTH, 0.5))
    assert finite("f", "n", GOOD).holds and finite("f", "n", grey, varied=False).holds
    assert not finite("f", "n", grey).holds
    failed = Outcome(2, "/tmp/x/scene/mesh.obj: the mesh has no faces; export it.", {})
    assert not finite("f", "n", failed).holds and not alike("f", "n", failed, GOOD, 1.0).holds
    said = refused("f", "n", failed, "faces")
    assert said.holds and "/tmp" not in said.note
    assert not refused("f", "n", failed, "photos").holds and not refused("f", "n", GOOD, "").holds
    assert not refused("f", "n", replace(failed, code=1), "faces").holds


def test_a_family_that_breaks_is_a_row_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def rows(progress: Callable[[str], None]) -> Iterator[Row]:
        progress("first")
        yield Row("first", "odd", "1 | 2", "3", True)
        raise ZeroDivisionError("oh")

    module = types.ModuleType("extremes.odd")
    module.rows = rows  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "extremes.odd", module)
    first, second = stability.measured(["odd"])
    assert first.holds and not second.holds and "oh" in second.measured
    page = stability.markdown([first, second], provenance())
    assert page.startswith("1 of 2 rows hold. Not: the rest") and "1 \\| 2" in page and "**no**" in page


def test_the_scene_goes_through_the_products_command(tmp_path) -> None:  # type: ignore[no-untyped-def]
    outcome = recover(write(make(), tmp_path / "scene"), *FIELD)
    assert outcome.code == 0 and not outcome.unsound and finite("f", "n", outcome).holds
    assert outcome.report["photos"] == 8
