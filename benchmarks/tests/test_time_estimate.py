"""The comparison of expected and actual seconds, and the fit of the table that the former come from."""

from dataclasses import asdict
from pathlib import Path

import pytest
from dante_w.estimate.seconds import Probe, Work, predict
from measure.fit_seconds import fit, model_of
from time_estimate import Row, arguments, compare, error, left_out, table

REPORT = {
    "expected": {"seconds": {"start": 2.0, "rays": 3.0, "final pass": 1.0}, "total_seconds": 6.0},
    "seconds": {"start": 2.0, "rays": 4.0, "write": 0.5},
}


def test_error_is_relative_to_what_it_took():
    assert error(13.0, 10.0) == pytest.approx(30.0)
    assert error(7.0, 10.0) == pytest.approx(-30.0)


def test_total_is_the_command_and_a_missing_stage_is_an_error_of_its_own():
    row = compare("apple", "draft", REPORT, 8.0)
    assert row.total == (6.0, 8.0)
    assert row.stages == {
        "start": (2.0, 2.0),
        "rays": (3.0, 4.0),
        "final pass": (1.0, 0.0),
        "write": (0.0, 0.5),
    }


def test_table_has_a_column_for_every_stage_of_any_row():
    rows = [compare("apple", "draft", REPORT, 8.0), Row("box", "high", {"bake": (1.0, 2.0)}, (1.0, 2.0))]
    head, _, first, second = table(rows).splitlines()
    assert head.split(" | ")[2:] == ["total", "start", "rays", "final pass", "write", "bake |"]
    assert "6.0 / 8.0 (-25%)" in first and "1.0 / 2.0 (-50%)" in second
    assert {line.count("|") for line in (head, first, second)} == {9}


def run(samples: float, texels: float, slowness: float, **more: object) -> dict:
    """The report of a run on a machine that takes 2e-6 s a sample and 1e-6 s a texel, or is slower."""
    work = Work(
        pixels=9e6,
        samples=samples,
        texels=texels,
        points=1e4,
        observations=1e5,
        lights=samples / 1e6,
    )
    seconds = {"scene": 1.0, "transfer": 2e-6 * samples, "bake": 1e-6 * texels}
    return {
        "settings": {"preset": "draft"},
        "expected": {},
        "photos": 20,
        "work": asdict(work),
        "probe": asdict(Probe(0.1 * slowness, 0.2 * slowness)),
        "seconds": {stage: slowness * value for stage, value in seconds.items()},
        **more,
    }


RUNS = [run(2e6, 1e6, 1.0), run(4e6, 4e6, 1.0), run(3e6, 1e6, 5.0), run(5e6, 4e6, 1.0), run(6e6, 2e6, 0.5)]


def test_seconds_per_unit_are_found_whatever_the_machine_did_beside():
    found = fit(RUNS)
    units = found["seconds_per_unit"]["traced draft"]
    assert units["bake"] == pytest.approx({"texels": 1e-6})
    assert units["transfer"]["samples"] == pytest.approx(2e-6, rel=1e-3)
    assert found["probe"] == pytest.approx({"arrays": 0.1, "matrices": 0.2})
    assert found["typical"]["draft"] == {"points": 10000, "views_per_photo": 0.5, "lights": 4}
    for report in RUNS:
        seconds = predict(Work(**report["work"]), "traced draft", Probe(**report["probe"]), table=found)
        assert seconds == pytest.approx({stage: report["seconds"][stage] for stage in seconds}, rel=1e-3)


def test_no_seconds_per_unit_are_negative():
    falling = [run(2e6, texels, 1.0, seconds={"albedo": 9.0 - texels / 1e6}) for texels in (1e6, 4e6, 8e6)]
    assert all(value > 0.0 for value in fit(falling)["seconds_per_unit"]["traced draft"]["albedo"].values())


def test_models_are_told_apart():
    report = run(1.0, 1.0, 1.0)
    assert model_of(report) == "traced draft"
    assert model_of({**report, "device": "cpu"}) == "field"
    del report["expected"]
    assert model_of(report) == "average"


def test_each_scene_is_predicted_from_the_others():
    reports = [("apple", RUNS[0]), ("apple", RUNS[1]), ("box", RUNS[3]), ("box", RUNS[4])]
    odd = run(2e6, 1e6, 1.0, seconds={"transfer": 10.0, "bake": 10.0})
    lines = left_out([*reports, ("odd", odd)]).splitlines()
    assert lines[-1] == "| odd | traced draft | 5.0 / 20.0 (-75%) |"


def test_commands_name_the_mesh_where_the_scene_does_not(tmp_path):
    (tmp_path / "mesh.obj").touch()
    mesh = ["--mesh", str(tmp_path / "mesh.obj")]
    assert arguments(tmp_path, "average", "", None) == ["average", str(tmp_path), *mesh]
    words = arguments(Path("a"), "field", "draft", "64")
    assert words == ["recover", "a", "--irradiance", "field", "--preset", "draft", "--texture-size", "64"]
