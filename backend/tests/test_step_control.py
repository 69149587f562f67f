"""Steps on lights that diverge are rejected and taken again with more damping, and the report says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dante_w.commands.cli import main
from dante_w.run import checkpoints
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.setbacks import MOST, Setback
from dante_w.traced.solver import levenberg_marquardt
from dante_w.traced.solver.normal_equations import Step, gauss_newton_step
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.solver.step_control import StepControl, StepControlSettings, damping_of, judge
from dante_w.traced.state import Lighting
from open_world import LIGHTS, PHOTOS, SETTINGS, World, albedo_error, make_world, solve

#: What a step is made to be.
WILD: dict[str, Callable[[Step], Step]] = {
    "not a number": lambda step: replace(step, log_radiance=np.nan * step.log_radiance),
    "too large for a float": lambda step: replace(step, log_radiance=step.log_radiance + 1e4),
    "anywhere": lambda step: replace(step, log_exposure=step.log_exposure + anywhere(step.log_exposure)),
}


def anywhere(exposure: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).normal(0.0, 2.0, len(exposure))


def strike(monkeypatch: pytest.MonkeyPatch, wild: Callable[[Step], Step], *turns: int) -> None:
    """Make the steps that are taken at these turns diverge, or all if there are none."""
    taken: list[int] = []

    def step(*arguments: Any) -> Step:
        lighting = gauss_newton_step(*arguments)
        taken.append(len(taken))
        return wild(lighting) if taken[-1] in turns or not turns else lighting

    monkeypatch.setattr(levenberg_marquardt, "gauss_newton_step", step)


def solved(world: World, settings: SolverSettings = SETTINGS) -> Lighting:
    return solve(world, np.arange(PHOTOS) % LIGHTS, settings)


def assert_finite(lighting: Lighting) -> None:
    for each in (lighting.radiance, lighting.log_exposure, lighting.bounce, lighting.albedo):
        assert np.isfinite(each).all()


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def plain(world: World) -> Lighting:
    return solved(world)


def test_sound_steps_are_accepted(plain):
    assert plain.setbacks == ()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("turn", [1, 7, 12])  # the second, the first with all directions, the last
def test_a_step_that_diverges_is_taken_again_and_all_ends_as_well(world, plain, monkeypatch, wild, turn):
    strike(monkeypatch, WILD[wild], turn)
    lighting = solved(world)
    (setback,) = lighting.setbacks
    assert setback.rate < 1.0 and ("finite" in setback.reason or "rose" in setback.reason)
    assert_finite(lighting)
    assert albedo_error(world, lighting) < 1.1 * albedo_error(world, plain)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_solve_that_cannot_be_saved_ends_where_it_was_sound(world, monkeypatch):
    strike(monkeypatch, WILD["not a number"])
    lighting = solved(world)
    assert len(lighting.setbacks) == MOST and {each.step for each in lighting.setbacks} == {1}
    assert_finite(lighting)
    assert np.ptp(lighting.radiance) < 1.0, "as at first"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_step_is_taken_again_with_more_damping_each_time(world, monkeypatch):
    dampings: list[float] = []

    def step(*arguments: Any) -> Step:
        dampings.append(arguments[-2])
        lighting = gauss_newton_step(*arguments)
        return WILD["not a number"](lighting) if 2 <= len(dampings) <= 4 else lighting

    monkeypatch.setattr(levenberg_marquardt, "gauss_newton_step", step)
    lighting = solved(world)
    assert [each.rate for each in lighting.setbacks] == pytest.approx([0.1, 0.01, 0.001])
    np.testing.assert_allclose(np.subtract(dampings[2:5], dampings[1]), [9.0, 99.0, 999.0])


def test_a_rise_that_is_accepted_at_first_is_not_in_the_end():
    sound, rules = [np.ones(3)], StepControlSettings()
    control, result = judge(StepControl(), 3, 16, 0.1, sound, rules)
    assert result.accepted and not result.reason and control == StepControl(lowest=0.1)
    rise = 1.5 * 0.1 + 0.9 * 0.5
    assert judge(control, 4, 16, rise, sound, rules)[1].accepted
    assert not judge(control, 16, 16, rise, sound, rules)[1].accepted
    for cost, unknowns in ((1.5 * 0.1 + 1.1 * 0.5, sound), (np.nan, sound), (0.1, [np.inf * sound[0]])):
        rejected, result = judge(control, 4, 16, cost, [*sound, *unknowns], rules)
        assert not result.accepted and result.reason and result.damping == rejected.damping > 1.0
        assert rejected.rate < 1.0 and rejected.setbacks[0].step == 4
        assert damping_of(4, rejected, rules) == 0.5**4 + rejected.damping
        accepted, result = judge(rejected, 4, 16, 0.1, sound, rules)
        assert result.accepted and accepted.rate == 1.0 and accepted.damping == result.damping == 0.0
        assert accepted.setbacks == rejected.setbacks


def test_equations_that_needed_more_damping_are_reported(world, monkeypatch):
    def step(*arguments: Any) -> Step:
        return replace(gauss_newton_step(*arguments), damping_factor=1e3)

    monkeypatch.setattr(levenberg_marquardt, "gauss_newton_step", step)
    lighting = solved(world, replace(SETTINGS, fine_steps=0))
    assert {each.rate for each in lighting.setbacks} == {1e-3}
    assert len(lighting.setbacks) == SETTINGS.coarse_steps - len(SETTINGS.reassignment_steps)


def test_setbacks_are_kept_with_the_lights(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    setbacks = (Setback(5, "the cost rose", 0.1), Setback(6, "the cost rose", 0.01))
    Checkpoints(tmp_path / "kept", "key").save("lights", replace(plain, setbacks=setbacks))
    lighting = Checkpoints(tmp_path / "kept", "key").load("lights", Lighting)
    assert lighting is not None and lighting.setbacks == setbacks


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("wild", [False, True])
def test_setbacks_are_in_the_report(scene: Path, tmp_path, monkeypatch, wild):
    if wild:
        strike(monkeypatch, WILD["too large for a float"], 1)
    options = ["--texture-size", "32", "--preset", "draft"]
    for part in ("clusters", "exposures", "specular"):  # nothing is tried: the first step is the fit's
        options += ["--model", part]
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *options]) == 0
    setbacks = json.loads((tmp_path / "out/report.json").read_text())["setbacks"]
    assert list(setbacks) == ["lights"] and len(setbacks["lights"]) == wild
    assert all(set(each) == {"step", "reason", "rate"} for each in setbacks["lights"])
