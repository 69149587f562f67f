"""Variants of the product: they change what they say and nothing else."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest
from dante_w.presets import PRESETS
from measure.command import ROOT
from measure.synthetic_scene import bumpy_sphere, write_photos, write_scene_folder
from methods.variant import altered, main, numbers

STANDARD = PRESETS["standard"]
PHOTOS, SIDE = 6, 48


def differences(changes: dict) -> dict:
    before, after = numbers(STANDARD), numbers(altered(STANDARD, changes))
    assert before.keys() == after.keys()
    return {name: value for name, value in after.items() if value != before[name]}


def test_a_change_changes_that_and_nothing_else():
    changes = {"field.model.albedo.levels": 8, "field.white_light": 0, "field.schedule.learning_rate": 0.5}
    assert differences(changes) == changes
    assert differences({}) == {}


def test_the_final_pass_follows_unless_it_is_given():
    steps = {"field.schedule.steps": 1001, "field.schedule.batch": 64}
    followed = {"field.final_pass.steps": 250, "field.final_pass.batch": 64}
    assert differences(steps) == steps | followed
    assert differences({"field.final_pass.steps": 7} | steps) == steps | followed | {
        "field.final_pass.steps": 7
    }


def test_the_presets_themselves_follow_that_rule():
    """Otherwise `schedule.steps` with the preset's own number would be another preset."""
    for name in ("draft", "standard", "high"):
        schedule = PRESETS[name].field.schedule
        same = {"field.schedule.steps": schedule.steps, "field.schedule.batch": schedule.batch}
        assert altered(PRESETS[name], same) == PRESETS[name]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"field.schedule.step": 3},
            "'field.schedule.step' is none of name, texture_size, .*field.schedule.steps",
        ),
        ({"field.schedule": 3}, "none of"),
        ({"field.schedule.steps": 2.5}, "must be of type int"),
        ({"field.schedule.steps": True}, "must be of type int"),
        ({"field.white_light": "much"}, "must be of type float"),
        ({"traced.shading.side": "fine"}, "must be of type int"),
    ],
)
def test_what_cannot_be_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        altered(STANDARD, changes)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("variant") / "scene"
    mesh = bumpy_sphere(12)
    write_scene_folder(folder, mesh, write_photos(folder, mesh, SIDE, PHOTOS), PHOTOS)
    return folder


def test_the_command_runs_what_the_changes_say(scene, tmp_path):
    changes = {
        "field.schedule.steps": 40,
        "field.schedule.batch": 256,
        "field.model.irradiance.levels": 3,
        "field.model.albedo.log2_table": 10,
    }
    arguments = ["recover", scene, "--irradiance", "field", "--preset", "draft"]
    arguments += ["--texture-size", "64", "--json", "--out", tmp_path]
    command = [
        sys.executable,
        ROOT / "benchmarks/methods/variant.py",
        json.dumps(changes),
        *arguments,
    ]
    done = subprocess.run([str(part) for part in command], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    settings = altered(PRESETS["draft"], changes)
    fields = {"texture_size": settings.texture_size, **dataclasses.asdict(settings.field)}
    wanted = json.loads(json.dumps(fields))
    for preset in (wanted, report["preset"]):  # these follow the photos, see `limit_resolution`
        del preset["model"]["albedo"]["levels"], preset["model"]["albedo"]["finest"]
    assert report["preset"] == wanted
    assert report["settings"]["preset"] == "draft" and report["texture_size"] == 64
    steps = [json.loads(line) for line in done.stdout.splitlines()]
    assert {line["total"] for line in steps if line["stage"] == "optimise"} == {40}


@pytest.mark.parametrize("changes", ['{"field.schedule.step": 3}', "[3]", "steps=3", None])
def test_the_command_refuses_in_a_sentence(changes, capsys):
    before = dict(PRESETS)
    assert main([changes, "recover", "scene", "--out", "out"] if changes else []) == 2
    words = capsys.readouterr().err
    assert words.startswith("variant: the first argument holds the changes, but ")
    assert words.count("\n") == 1
    assert before == PRESETS
