"""Steps on lights that go astray are taken back and taken again, and the report says so."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dante_w.commands.cli import main
from dante_w.run import checkpoints
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.setbacks import MOST, Setback
from dante_w.traced.solver import solve_lights as lights
from dante_w.traced.solver.solve_lights import FIRST_STEPS, solve_lights
from dante_w.traced.solver.step_control import MARGIN, ROSE, Course, look
from dante_w.traced.state import Lighting
from open_world import LIGHTS, PHOTOS, World, make_world

STEP = lights.step
Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
#: What a step is made to change log radiance and exposures by.
WILD: dict[str, Change] = {
    "not a number": lambda change, shift: (np.nan * change, shift),
    "too large for a float": lambda change, shift: (change + 1e4, shift),
    "anywhere": lambda change, shift: (change, shift + np.random.default_rng(0).normal(0.0, 2.0, len(shift))),
}


def struck(monkeypatch: pytest.MonkeyPatch, wild: Change, *at: int) -> None:
    """Have the steps that are taken `at` these turns, or all if there are none, go astray."""
    turns: list[int] = []

    def step(*arguments: Any) -> Any:
        change, shift, *rest = STEP(*arguments)
        turns.append(len(turns))
        return (*(wild(change, shift) if turns[-1] in at or not at else (change, shift)), *rest)

    monkeypatch.setattr(lights, "step", step)


def solved(world: World) -> Lighting:
    light = np.arange(PHOTOS) % LIGHTS
    return solve_lights(world.points, world.transfer, world.seen, world.cameras, light, 0, lambda *_: None)


def error(world: World, found: Lighting) -> float:
    """Rms of log albedo at known points, after one gain per channel."""
    off = np.log(found.albedo[found.known]) - np.log(world.albedo[found.known])
    return float(np.sqrt(np.square(off - off.mean(axis=0)).mean()))


def assert_finite(found: Lighting) -> None:
    for each in (found.radiance, found.log_exposure, found.bounce, found.albedo):
        assert np.isfinite(each).all()


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def plain(world: World) -> Lighting:
    return solved(world)


def test_a_sound_solve_is_left_alone(plain):
    assert plain.setbacks == ()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("turn", [1, 7, 12])  # the second, the first with all directions, the last
def test_a_step_that_goes_astray_is_taken_again_and_all_ends_as_well(world, plain, monkeypatch, wild, turn):
    struck(monkeypatch, WILD[wild], turn)
    found = solved(world)
    (setback,) = found.setbacks
    assert setback.rate < 1.0 and ("finite" in setback.reason or "rose" in setback.reason)
    assert_finite(found)
    assert error(world, found) < 1.1 * error(world, plain)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_solve_that_cannot_be_saved_ends_where_it_was_sound(world, monkeypatch):
    struck(monkeypatch, WILD["not a number"])
    found = solved(world)
    assert len(found.setbacks) == MOST and {each.step for each in found.setbacks} == {1}
    assert_finite(found)
    assert np.ptp(found.radiance) < 1.0, "as at first"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_step_is_taken_again_with_more_damping_each_time(world, monkeypatch):
    dampings: list[float] = []

    def step(*arguments: Any) -> Any:
        dampings.append(arguments[-1])
        change, *rest = STEP(*arguments)
        return (np.nan * change if 2 <= len(dampings) <= 4 else change, *rest)

    monkeypatch.setattr(lights, "step", step)
    found = solved(world)
    assert [each.rate for each in found.setbacks] == pytest.approx([0.1, 0.01, 0.001])
    np.testing.assert_allclose(np.subtract(dampings[2:5], dampings[1]), [9.0, 99.0, 999.0])


def test_a_rise_that_is_borne_at_first_is_not_in_the_end():
    sound = np.ones(3)
    course, well = look(Course(), 3, 16, 0.1, [sound])
    assert well and course == Course(lowest=0.1)
    assert look(course, 4, 16, ROSE * 0.1 + 0.9 * MARGIN, [sound])[1]
    assert not look(course, 16, 16, ROSE * 0.1 + 0.9 * MARGIN, [sound])[1]
    for cost, found in ((ROSE * 0.1 + 1.1 * MARGIN, sound), (np.nan, sound), (0.1, sound * np.inf)):
        fallen, well = look(course, 4, 16, cost, [sound, found])
        assert not well and fallen.rate < 1.0 and fallen.harder > 1.0 and fallen.setbacks[0].step == 4
        again, well = look(fallen, 4, 16, 0.1, [sound])
        assert well and again.rate == 1.0 and again.harder == 0.0 and again.setbacks == fallen.setbacks


def test_equations_that_had_to_be_damped_harder_are_told(world, monkeypatch):
    def step(*arguments: Any) -> Any:
        return (*STEP(*arguments)[:3], 1e-3)

    monkeypatch.setattr(lights, "step", step)
    monkeypatch.setattr(lights, "LAST_STEPS", 0)
    found = solved(world)
    assert {each.rate for each in found.setbacks} == {1e-3}
    assert len(found.setbacks) == FIRST_STEPS - len(lights.REASSIGN)


def test_setbacks_are_kept_with_the_lights(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    setbacks = (Setback(5, "the cost rose", 0.1), Setback(6, "the cost rose", 0.01))
    Checkpoints(tmp_path / "kept", "key").save("lights", dataclasses.replace(plain, setbacks=setbacks))
    found = Checkpoints(tmp_path / "kept", "key").load("lights", Lighting)
    assert found is not None and found.setbacks == setbacks


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("wild", [False, True])
def test_setbacks_are_in_the_report(scene: Path, tmp_path, monkeypatch, wild):
    if wild:
        struck(monkeypatch, WILD["too large for a float"], 1)
    options = ["--texture-size", "32", "--preset", "draft"]
    for part in ("groups", "exposures", "gloss"):  # nothing is tried: the first step is the lights' own
        options += ["--model", part]
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *options]) == 0
    found = json.loads((tmp_path / "out/report.json").read_text())["setbacks"]
    assert list(found) == ["lights"] and len(found["lights"]) == wild
    assert all(set(each) == {"step", "reason", "rate"} for each in found["lights"])
