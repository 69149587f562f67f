"""What is said before a run: positive, growing with the work, adding up, and leaving the run as it is."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
import torch
from conftest import make_scene
from dante_w.contract.protocol import Quality
from dante_w.estimate.expectation import QUALITY, Expectation, Work, predict
from dante_w.estimate.pace import Pace, Texture, measure, take
from dante_w.field.fields import FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.field.pipeline import FieldRun
from dante_w.field.settings import FieldSettings
from dante_w.field.terms import LossTerms
from dante_w.presets import PRESETS
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.load import load_scene

PACE = Pace(
    read=2e-8,
    mesh=0.01,
    ray=1e-6,
    foreground=0.3,
    bake=3e-7,
    write=2e-7,
    step=0.05,
    photo_step=0.01,
    render=1e-6,
)
WORK = Work(
    photos=40,
    pixels=40 << 18,
    texels=1 << 22,
    held_out_pixels=5 << 18,
    held_out_steps=100,
    steps=500,
    final_steps=125,
)
SPEC = FieldSpec(GridSpec(2, 6, 2, 4, 64, 12), GridSpec(3, 2, 2, 2, 4, 10), hidden=16, embedding=4)


def field_run(**terms: float) -> FieldRun:
    settings = FieldSettings(SPEC, Schedule(500, 512), Schedule(125, 512))
    return FieldRun(settings, LossTerms(**terms), np.arange(5), torch.device("cpu"), 0, True)


def test_every_stage_of_work_has_its_seconds():
    seconds = predict(PACE, WORK)
    assert list(seconds) == ["rays", "optimise", "held-out", "final pass", "bake", "write"]
    assert all(math.isfinite(value) and value > 0.0 for value in seconds.values())
    without = dataclasses.replace(WORK, held_out_pixels=0, steps=0, final_steps=0)
    assert list(predict(PACE, without)) == ["rays", "bake", "write"]


@pytest.mark.parametrize(
    ("more", "stage"),
    [
        ({"pixels": 80 << 18}, "rays"),
        ({"photos": 80, "pixels": 80 << 18}, "rays"),
        ({"held_out_pixels": 10 << 18}, "held-out"),
        ({"steps": 1000}, "optimise"),
        ({"final_steps": 250}, "final pass"),
        ({"texels": 1 << 24}, "bake"),
        ({"texels": 1 << 24}, "write"),
    ],
)
def test_more_work_takes_longer(more, stage):
    less, longer = predict(PACE, WORK), predict(PACE, dataclasses.replace(WORK, **more))
    assert longer[stage] > less[stage]
    assert all(longer[name] >= less[name] for name in less)


def test_one_photo_of_one_pixel_to_one_texel():
    seconds = predict(PACE, Work(photos=1, pixels=1, texels=1))
    assert all(math.isfinite(value) and value > 0.0 for value in seconds.values())


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float16])
@pytest.mark.parametrize(("photos", "side"), [(1, 1), (6, 32)])
def test_every_pace_is_measured(tmp_path, photos, side, kind):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", photos))
    pace = measure(take(scene.frames, Scene3D.build(mesh)), mesh, Texture(side, kind), tmp_path, field_run())
    values = dataclasses.asdict(pace)
    assert all(math.isfinite(value) and value > 0.0 for value in values.values()), values
    assert pace.foreground == 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
    unfitted = measure(take(scene.frames, Scene3D.build(mesh)), mesh, Texture(side, kind), tmp_path)
    assert (unfitted.step, unfitted.photo_step, unfitted.render) == (0.0, 0.0, 0.0)


def test_measuring_draws_no_random_numbers_of_the_run(tmp_path):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", 6))
    torch.manual_seed(3)
    np.random.seed(3)
    before = torch.get_rng_state(), np.random.get_state()[1].tolist()
    measure(take(scene.frames, Scene3D.build(mesh)), mesh, Texture(16, np.uint8), tmp_path, field_run())
    assert torch.equal(before[0], torch.get_rng_state())
    assert before[1] == np.random.get_state()[1].tolist()


def test_photos_beside_the_mesh_are_left_to_the_run_to_refuse(tmp_path):
    folder = make_scene(tmp_path / "scene", 2)
    scene, mesh = load_scene(folder)
    aside = dataclasses.replace(mesh, vertices=mesh.vertices + 90.0)
    pace = measure(
        take(scene.frames, Scene3D.build(aside)), aside, Texture(16, np.uint8), tmp_path, field_run()
    )
    assert pace.step > 0.0


def test_priors_are_part_of_the_steps(tmp_path):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", 2))
    frames = [dataclasses.replace(frame, albedo=frame.image) for frame in scene.frames]
    only_priors = field_run(photometric=False, prior_weight=1.0)
    assert (
        measure(take(frames, Scene3D.build(mesh)), mesh, Texture(16, np.uint8), tmp_path, only_priors).step
        > 0.0
    )


def test_stages_add_up_to_the_total():
    said = Expectation({"start": 2.0004, "rays": 3.0004, "bake": 0.0004}, Quality(24.9, 21.0, 28.5)).as_dict()
    assert said["total_seconds"] == pytest.approx(sum(said["seconds"].values()), abs=1e-9)
    assert said["albedo_psnr_after_gain"] == {"mean": 24.9, "lowest": 21.0, "highest": 28.5}
    assert json.loads(json.dumps(said)) == said
    assert Expectation({"rays": 1.0}, None).as_dict()["albedo_psnr_after_gain"] is None


def test_the_sentence_says_what_is_known_and_no_more():
    known = Expectation({"rays": 44.6}, Quality(24.9, 21.0, 28.5))
    assert known.sentence("standard", False) == (
        "standard: about 45 s here; on four rendered test objects without priors this preset reached 24.9 dB "
        "(21.0 to 28.5), albedo PSNR after one gain per channel"
    )
    unknown = Expectation({"rays": 5000.0}, None)
    assert "about 1 h 23 min here" in unknown.sentence("high", False)
    assert "not measured" in unknown.sentence("high", False)
    assert "depends on the priors" in unknown.sentence("high", True)


def test_every_preset_has_an_entry_of_quality():
    assert set(QUALITY) == {"traced", "field"}
    for of_presets in QUALITY.values():
        assert set(of_presets) == set(PRESETS)
        for quality in filter(None, of_presets.values()):
            assert quality.lowest <= quality.mean <= quality.highest
