"""Variants of the product: they change what they say and nothing else."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.presets import PRESETS
from dante_w.rays.ray_cache import RayCache, Surface
from measure.command import ROOT
from measure.synthetic_scene import bumpy_sphere, write_photos, write_scene_folder
from methods.variant import altered, bfloat16_model, fields, main, thinned

STANDARD = PRESETS["standard"]
SPEC = ModelSpec(GridSpec(2, 4, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 4, 10), hidden=16, embedding=4)
PHOTOS, SIDE = 6, 48


def differences(changes: dict) -> dict:
    before, after = fields(STANDARD), fields(altered(STANDARD, changes))
    assert before.keys() == after.keys()
    return {name: value for name, value in after.items() if value != before[name]}


def test_a_change_changes_that_and_nothing_else():
    changes = {"model.albedo.levels": 8, "white_light": 0, "schedule.learning_rate": 0.5}
    assert differences(changes) == changes
    assert differences({}) == {}


def test_the_final_pass_follows_unless_it_is_given():
    steps = {"schedule.steps": 1001, "schedule.batch": 64}
    followed = {"final_pass.steps": 250, "final_pass.batch": 64}
    assert differences(steps) == steps | followed
    assert differences({"final_pass.steps": 7} | steps) == steps | followed | {"final_pass.steps": 7}


def test_the_presets_themselves_follow_that_rule():
    """Otherwise `schedule.steps` with the preset's own number would be another preset."""
    for name in ("draft", "standard", "high"):
        schedule = PRESETS[name].schedule
        same = {"schedule.steps": schedule.steps, "schedule.batch": schedule.batch}
        assert altered(PRESETS[name], same) == PRESETS[name]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"schedule.step": 3}, "'schedule.step' is none of texture_size, .*schedule.steps.*ray_fraction"),
        ({"schedule": 3}, "none of"),
        ({"schedule.steps": 2.5}, "must be of type int"),
        ({"schedule.steps": True}, "must be of type int"),
        ({"white_light": "much"}, "must be of type float"),
        ({"ray_fraction": 0}, "above 0 and at most 1"),
        ({"decoder_precision": "float8"}, "must be float32 or bfloat16"),
        ({"traced.side": 0}, "must be a whole number above 0"),
    ],
)
def test_what_cannot_be_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        altered(STANDARD, changes)


def test_thinned_keeps_a_fraction_of_every_photo():
    counts = np.array([3000, 0, 5000, 2000])
    starts = np.concatenate([[0], np.cumsum(counts)])
    numbers = np.arange(starts[-1])
    surface = Surface(torch.zeros(1, 3, 2), torch.zeros(1, 3, 3))
    finest = np.ones((2, 2), np.float32)
    two, three = (np.stack([numbers] * count, 1) for count in (2, 3))
    cache = RayCache(surface, starts, numbers, two, three, None, numbers / 2, finest, numbers)
    thin = thinned(cache, 0.25)
    assert np.diff(thin.starts) == pytest.approx(counts / 4, rel=0.15)
    assert thin.starts[0] == 0 and len(thin) == len(thin.face)
    for photo, (first, end) in enumerate(zip(thin.starts, thin.starts[1:], strict=False)):
        kept = thin.face[first:end]
        assert (np.diff(kept) > 0).all()
        assert ((kept >= starts[photo]) & (kept < starts[photo + 1])).all()
    assert (thin.bary[:, 1] == thin.face).all() and (thin.colour[:, 2] == thin.face).all()
    assert (thin.footprint == thin.face / 2).all() and (thin.edge == thin.face).all()
    assert thin.finest is finest and thin.prior is None
    assert len(thinned(dataclasses.replace(cache, prior=cache.colour), 0.25).prior) == len(thin)


def test_bfloat16_rounds_the_fit_and_spares_the_bake():
    torch.manual_seed(0)
    exact = Model(SPEC, 3)
    torch.manual_seed(0)
    rounded = bfloat16_model(SPEC, 3)
    for parameter, other in zip(exact.parameters(), rounded.parameters(), strict=True):
        assert torch.equal(parameter, other)
        with torch.no_grad():
            values = 0.5 * torch.randn(parameter.shape)
            parameter.copy_(values)
            other.copy_(values)
    uv = torch.rand(500, 2)
    ours, theirs = rounded.albedo(uv), exact.albedo(uv)
    assert ours.dtype == torch.float32
    assert 1e-5 < float((ours - theirs).detach().abs().max()) < 0.05
    gradient, wanted = (
        torch.autograd.grad(a.sum(), m.albedo.grid.tables)[0] for a, m in ((ours, rounded), (theirs, exact))
    )
    assert gradient.dtype == torch.float32
    assert torch.nn.functional.cosine_similarity(gradient.ravel(), wanted.ravel(), dim=0) > 0.999
    with torch.no_grad():
        torch.testing.assert_close(
            rounded.albedo(uv), exact.albedo(uv)
        )  # torch and kernels round differently


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("variant") / "scene"
    mesh = bumpy_sphere(12)
    write_scene_folder(folder, mesh, write_photos(folder, mesh, SIDE, PHOTOS), PHOTOS)
    return folder


def test_the_command_runs_what_the_changes_say(scene, tmp_path):
    changes = {
        "schedule.steps": 40,
        "schedule.batch": 256,
        "model.irradiance.levels": 3,
        "model.albedo.log2_table": 10,
    }
    outside = {"ray_fraction": 0.1, "decoder_precision": "bfloat16"}
    arguments = ["recover", scene, "--irradiance", "field", "--preset", "draft"]
    arguments += ["--texture-size", "64", "--json", "--out", tmp_path]
    command = [
        sys.executable,
        ROOT / "benchmarks/methods/variant.py",
        json.dumps(changes | outside),
        *arguments,
    ]
    done = subprocess.run([str(part) for part in command], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    wanted = dataclasses.asdict(altered(PRESETS["draft"], changes))
    for preset in (wanted, report["preset"]):  # these follow the photos, see `sized`
        del preset["model"]["albedo"]["levels"], preset["model"]["albedo"]["finest"]
    assert report["preset"] == wanted
    assert report["settings"]["preset"] == "draft" and report["texture_size"] == 64
    steps = [json.loads(line) for line in done.stdout.splitlines()]
    assert {line["total"] for line in steps if line["stage"] == "optimise"} == {40}
    assert 0.03 < report["samples"] / (PHOTOS * SIDE**2) < 0.1  # a tenth of what shows the sphere


@pytest.mark.parametrize("changes", ['{"schedule.step": 3}', "[3]", "steps=3", None])
def test_the_command_refuses_in_a_sentence(changes, capsys):
    before = dict(PRESETS)
    assert main([changes, "recover", "scene", "--out", "out"] if changes else []) == 2
    words = capsys.readouterr().err
    assert words.startswith("variant: the first argument holds the changes, but ")
    assert words.count("\n") == 1
    assert before == PRESETS
