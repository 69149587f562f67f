"""What traced light is expected to take: positive, growing with the work, and measured on any scene."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from conftest import make_scene
from dante_w.estimate.pace import take
from dante_w.estimate.traced_pace import TracedPace, TracedWork, measure_traced, predict_traced
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.load import load_scene

PACE = TracedPace(
    gather=3e-7,
    trace=1e-4,
    explain=2e-7,
    level=2e-7,
    shine=4e-10,
    multiply=2e-11,
    factor=3e-11,
    albedo=1e-6,
    fill=1e-8,
)
WORK = TracedWork(
    photos=40,
    samples=2e6,
    points=4e4,
    observations=5e5,
    directions=256,
    first_lights=10,
    lights=5,
    texels=1 << 20,
    suns=False,
    goes_on=True,
)


def test_every_stage_has_its_seconds():
    seconds = predict_traced(PACE, WORK)
    assert list(seconds) == ["transfer", "plan", "lights", "albedo"]
    assert all(math.isfinite(value) and value > 0.0 for value in seconds.values())


@pytest.mark.parametrize(
    ("more", "stages"),
    [
        ({"samples": 4e6}, {"transfer", "albedo"}),
        ({"points": 6e4}, {"transfer", "plan", "lights"}),
        ({"observations": 1e6}, {"plan", "lights"}),
        ({"directions": 400}, {"lights"}),
        ({"lights": 8}, {"plan", "lights"}),
        ({"texels": 1 << 24}, {"albedo"}),
        ({"suns": True}, {"lights"}),
        ({"goes_on": False}, {"lights"}),
    ],
)
def test_more_work_takes_longer(more, stages):
    less, longer = predict_traced(PACE, WORK), predict_traced(PACE, dataclasses.replace(WORK, **more))
    assert {name for name in less if longer[name] > less[name]} == stages
    assert all(longer[name] >= less[name] for name in less)


@pytest.mark.parametrize("photos", [1, 8])
def test_every_pace_is_measured_and_the_work_counted(tmp_path, photos):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", photos))
    pixels = photos * 48 * 36
    pace, work = measure_traced(
        take(scene.frames, Scene3D.build(mesh)), photos, pixels, 16, 64 * 64, True, True
    )
    values = dataclasses.asdict(pace)
    assert all(math.isfinite(value) and value >= 0.0 for value in values.values()), values
    assert min(value for name, value in values.items() if name != "albedo") > 0.0
    assert (work.photos, work.directions, work.texels) == (photos, 16, 64 * 64)
    assert (work.first_lights, work.lights) == (min(photos, 10), min(photos, 7))
    assert 0.3 * pixels < work.samples < pixels  # the square fills much of each photo
    assert 500 < work.points < 48 * 36 * photos
    assert work.points <= work.observations <= photos * work.points


def test_photos_beside_the_mesh_are_left_to_the_run_to_refuse(tmp_path):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", 2))
    aside = dataclasses.replace(mesh, vertices=mesh.vertices + 90.0)
    pace, work = measure_traced(take(scene.frames, Scene3D.build(aside)), 2, 2 * 48 * 36, 16, 1, True, True)
    assert work.samples == 0.0
    assert all(map(math.isfinite, predict_traced(pace, work).values()))


def test_measuring_draws_no_random_numbers_of_the_run(tmp_path):
    scene, mesh = load_scene(make_scene(tmp_path / "scene", 2))
    np.random.seed(3)
    before = np.random.get_state()[1].tolist()
    measure_traced(take(scene.frames, Scene3D.build(mesh)), 2, 2 * 48 * 36, 16, 64, True, True)
    assert before == np.random.get_state()[1].tolist()
