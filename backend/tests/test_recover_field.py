"""The command from end to end with the paper's model."""

from __future__ import annotations

import dataclasses
import json

import pytest
from command_runs import FIELD, FIELD_PLAN, SIZE, SMALL, accuracy, recover, run, write_priors
from dante_w.commands.cli import main
from dante_w.field.optimise import Schedule
from square_scene import make_scene

FIELD_STAGES = ["scene", "rays", "optimise", "held-out", "final pass", "bake", "write"]


def test_the_papers_model_recovers_better_than_the_average(square, recovered, tmp_path):
    folder, events = recovered(*FIELD)
    assert run("average", square, "--out", tmp_path / "mean", "--texture-size", str(SIZE))[0] == 0
    assert accuracy(folder, gain=True) > accuracy(tmp_path / "mean", gain=True) + 1.0
    assert accuracy(folder, gain=True) > 24.0

    stages = list(dict.fromkeys(event["stage"] for event in events))
    assert stages == ["scene", "expected", "rays", "planned", *FIELD_STAGES[2:], "done"]
    for event in events[:-1]:
        if event["stage"] in ("expected", "planned"):
            continue
        assert set(event) == {"stage", "step", "total", "loss", "seconds_left"}
        assert 0 <= event["step"] <= event["total"]
    report = json.loads((folder / "report.json").read_text())
    assert report == events[-1]["report"]
    assert report["texture_size"] == SIZE and report["photos"] == 8
    assert report["held_out_psnr"] > 24.0
    assert 0.9 < report["coverage"] <= 1.0
    assert report["peak_memory_bytes"] > 1 << 26
    assert list(report["seconds"]) == ["start", *FIELD_STAGES]
    (said,) = (event for event in events if event["stage"] == "expected")
    assert said == {"stage": "expected", **report["expected"]}
    assert list(report["expected"]["seconds"]) == list(report["seconds"])
    assert report["expected"]["albedo_psnr_after_gain"]["mean"] > 20.0
    assert sorted(path.name for path in folder.iterdir()) == ["albedo.png", "coverage.png", "report.json"]


def test_the_same_seed_gives_the_same_bytes_and_another_gives_others(square, recovered, tmp_path, capsys):
    """Also where people read along, who are told before the work begins."""
    out = tmp_path / "out"
    assert main(["recover", str(square), "--out", str(out), *FIELD], settings=SMALL) == 0
    line, *plan = capsys.readouterr().err.splitlines()
    assert line.startswith("standard: about ") and "dB" in line
    assert [line.split(":")[0] for line in plan] == FIELD_PLAN
    first = (recovered(*FIELD).folder / "albedo.png").read_bytes()
    assert (out / "albedo.png").read_bytes() == first
    assert (recovered(*FIELD, "--seed", "4").folder / "albedo.png").read_bytes() != first


def test_in_the_papers_model_a_good_prior_decides_level_and_colour(square, tmp_path):
    priors = write_priors(square, tmp_path / "priors")
    for name, extra in (("both", []), ("lifted", ["--no-photometric"]), ("ignored", ["--lambda", "0"])):
        report = recover(square, tmp_path / name, "--priors", priors, *FIELD, *extra).report
        assert report["priors"] == 8
        reached = report["expected"]["albedo_psnr_after_gain"]
        assert (reached is None) == (name != "ignored"), "with priors they decide, so nothing is promised"
    assert accuracy(tmp_path / "both") > 24.0
    assert accuracy(tmp_path / "lifted") > 24.0
    assert accuracy(tmp_path / "ignored") < accuracy(tmp_path / "both") - 3.0


def test_keep_held_out_skips_the_final_pass(recovered):
    result = recovered(*FIELD, "--keep-held-out")
    assert "final pass" not in {event["stage"] for event in result.events}
    assert "final pass" not in result.report["expected"]["seconds"]
    assert result.report["held_out_photos"] == ["4.png"]


def test_few_photos_hold_none_out(tmp_path):
    few = make_scene(tmp_path / "s", photos=2)
    assert recover(few, tmp_path / "out", *FIELD).report["held_out_psnr"] is None


def test_a_fit_that_diverges_is_no_success(square, tmp_path, capsys):
    schedule = Schedule(20, 2048, float("inf"))
    wild = dataclasses.replace(SMALL, field=dataclasses.replace(SMALL.field, schedule=schedule))
    assert (
        main(["recover", str(square), "--out", str(tmp_path / "out"), *FIELD, "--json"], settings=wild) == 1
    )
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "diverged" in events[-1]["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("ablation", ["--equal-bands", "--no-photometric"])
def test_ablations_belong_to_the_papers_model(square, tmp_path, ablation):
    out = tmp_path / "out"
    code, events = run("recover", square, "--out", out, "--irradiance", "traced", ablation)
    assert (code, events[-1]["stage"], events[-1]["code"]) == (2, "error", 2)
    assert "--irradiance" in events[-1]["message"] and "\n" not in events[-1]["message"]
    assert not out.exists()


def test_an_ablation_asks_for_the_papers_model(recovered):
    assert "optimise" in {event["stage"] for event in recovered("--equal-bands").events}
