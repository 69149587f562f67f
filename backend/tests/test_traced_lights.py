"""Lights by variable projection, on open points whose lights and albedo are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dante_w.errors import BadInput
from dante_w.traced.gloss import sheen
from dante_w.traced.lights import BRIGHTEST, FEWEST_PHOTOS, TOP, Lights, solve_lights
from dante_w.traced.shading_points import Observations, ShadingPoints
from dante_w.traced.transfer import Transfer, sphere

DIRECTIONS, POINTS, PHOTOS, LIGHTS = 64, 1500, 18, 3
LIGHT = np.arange(PHOTOS) % LIGHTS


@dataclasses.dataclass(frozen=True)
class World:
    points: ShadingPoints
    transfer: Transfer
    seen: Observations
    cameras: np.ndarray
    albedo: np.ndarray
    exposure: np.ndarray


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def make_world() -> World:
    """Open points of all orientations under three smooth lights; nothing hides or lights anything else."""
    random = np.random.default_rng(6)
    normals = unit(random.normal(size=(POINTS, 3))).astype(np.float32)
    position = random.uniform(0.3, 0.7, (POINTS, 3)).astype(np.float32)
    directions = sphere(DIRECTIONS).astype(np.float32)
    cosine = normals @ directions.T
    visible = (cosine > 0.0).astype(np.float32)
    direct = (4.0 / DIRECTIONS * np.maximum(cosine, 0.0)).astype(np.float32)
    transfer = Transfer(
        directions,
        visible,
        direct,
        np.zeros(POINTS + 1, np.int64),
        np.zeros(0, np.int64),
        np.zeros(0, np.float32),
        np.zeros(POINTS, np.float32),
    )
    axes = unit(np.array([(1.0, 0.2, 0.5), (-0.6, 0.8, 0.4), (-0.3, -0.9, 0.6)]))
    tint = np.array([(0.08, 0.0, -0.08), (-0.06, 0.0, 0.06), (0.0, 0.0, 0.0)])
    bright = 1.1 * directions @ axes.T + 0.5 * (directions @ axes.T) ** 2
    radiance = np.exp(bright.T[:, :, None] + tint[:, None, :]).astype(np.float32)
    albedo = random.uniform(0.1, 0.8, (POINTS, 3))
    albedo *= TOP / np.quantile(albedo.max(axis=1), BRIGHTEST)
    exposure = random.normal(0.0, 0.35, PHOTOS)
    cameras = 0.5 + 2.0 * sphere(PHOTOS)

    photo, point = np.nonzero(np.einsum("kd,cd->kc", unit(cameras - 0.5), normals) > 0.05)
    towards = unit(cameras[photo] - position[point]).astype(np.float32)
    light = LIGHT[photo]
    diffuse = albedo[point] * np.tensordot(direct, radiance, axes=(1, 1))[point, light]
    gloss = sheen(point, light, towards, normals, directions, visible, radiance)
    colour = np.exp(exposure)[photo, None] * (diffuse + gloss)
    colour *= np.exp(random.normal(0.0, 0.03, colour.shape))
    count = len(photo)
    seen = Observations(
        point.astype(np.int32),
        photo.astype(np.int32),
        colour.astype(np.float32),
        np.full(count, 4, np.int32),
        np.zeros(count, bool),
    )
    points = ShadingPoints(np.full(1, -1, np.int32), position, normals)
    return World(points, transfer, seen, cameras, albedo, exposure)


def solved(world: World, seen: Observations | None = None, seed: int = 0) -> Lights:
    """Starting with each light split in two and one photo in the wrong group."""
    first = LIGHT + LIGHTS * (np.arange(PHOTOS) >= PHOTOS // 2)
    first[0] = first[1]
    said: list[tuple[int, int]] = []
    found = solve_lights(
        world.points,
        world.transfer,
        seen or world.seen,
        world.cameras,
        first,
        seed,
        lambda *step: said.append(step),
    )
    assert [step for step, _ in said] == list(range(1, said[-1][1] + 1))
    return found


def albedo_error(world: World, found: Lights) -> float:
    """Rms of log albedo at known points, after one gain per channel."""
    error = np.log(found.albedo[found.known]) - np.log(world.albedo[found.known])
    return float(np.sqrt(np.square(error - error.mean(axis=0)).mean()))


def assert_finite(found: Lights) -> None:
    for name, value in vars(found).items():
        assert np.isfinite(value).all(), name


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def found(world: World) -> Lights:
    return solved(world)


def test_albedo_is_recovered_up_to_a_gain(world, found):
    assert_finite(found)
    assert found.known.mean() > 0.9
    assert albedo_error(world, found) < 0.03
    assert np.quantile(found.albedo[found.known].max(axis=1), BRIGHTEST) == pytest.approx(TOP, rel=1e-3)


def test_each_light_is_found_once_and_relative_exposures_are_right(world, found):
    together = found.light[:, None] == found.light
    assert (together == (LIGHT[:, None] == LIGHT)).all()
    assert found.radiance.shape == (LIGHTS, DIRECTIONS, 3)
    for j in range(LIGHTS):
        mine = j == LIGHT
        difference = found.log_exposure[mine] - world.exposure[mine]
        np.testing.assert_allclose(difference, difference.mean(), atol=0.02)


def test_the_model_explains_the_photos(world, found):
    seen = world.seen
    towards = unit(world.cameras[seen.photo] - world.points.position[seen.point]).astype(np.float32)
    light = found.light[seen.photo]
    transfer = world.transfer
    gloss = sheen(
        seen.point, light, towards, world.points.normal, transfer.directions, transfer.visible, found.radiance
    )
    irradiance = np.tensordot(transfer.direct, found.radiance, axes=(1, 1)) + found.bounce
    gain = np.exp(found.log_exposure)[seen.photo, None]
    shown = gain * (found.albedo[seen.point] * irradiance[seen.point, light] + gloss)
    rows = found.known[seen.point]
    error = np.log(shown[rows] / seen.colour[rows])
    assert np.sqrt(np.square(error).mean()) < 0.04


def test_without_light_solving_the_error_is_far_larger(world, found):
    """What the photos' mean would give: the bound above says something."""
    seen = world.seen
    total = np.bincount(seen.point, minlength=POINTS)
    own = np.log(seen.colour) - world.exposure[seen.photo, None]
    mean = np.stack([np.bincount(seen.point, c, POINTS) for c in own.T], axis=1)[found.known]
    error = mean / total[found.known, None] - np.log(world.albedo[found.known])
    assert np.sqrt(np.square(error - error.mean(axis=0)).mean()) > 5 * albedo_error(world, found)


def test_clipped_and_black_observations_are_survived(world):
    random = np.random.default_rng(7)
    colour = world.seen.colour.copy()
    fate = random.random(len(colour))
    colour[fate < 0.05] = 0.0
    colour[fate > 0.95] = 1.0
    seen = dataclasses.replace(world.seen, colour=colour, clipped=fate > 0.95)
    found = solved(world, seen)
    assert_finite(found)
    assert (found.albedo > 0.0).all()
    assert albedo_error(world, found) < 0.06


def test_a_point_that_too_few_photos_see_is_not_known(world, found):
    rows = np.ones(len(world.seen.point), bool)
    for point in range(50):
        rows[np.flatnonzero(world.seen.point == point)[FEWEST_PHOTOS - 1 :]] = False
    rows[world.seen.point == 50] = False
    clipped = dataclasses.replace(world.seen, clipped=world.seen.point == 51)  # sees nothing either
    fewer = solved(world, clipped.of(rows))
    assert not fewer.known[:52].any() and found.known[:52].sum() > 40
    assert fewer.known[52:].tolist() == found.known[52:].tolist()
    assert_finite(fewer)
    np.testing.assert_allclose(fewer.albedo[:52], np.tile(fewer.albedo[0], (52, 1)))  # filled in


def test_same_seed_same_arrays(world, monkeypatch):
    monkeypatch.setattr("dante_w.traced.lights.POINTS", 400)
    monkeypatch.setattr("dante_w.traced.lights.STEPS", 4)
    first, again, other = (solved(world, seed=seed) for seed in (1, 1, 2))
    for name in vars(first):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name), name)
    assert not np.array_equal(first.radiance, other.radiance)


def test_too_few_photos_are_bad_input(world):
    with pytest.raises(BadInput, match="photos"):
        solved(world, world.seen.of(world.seen.photo < FEWEST_PHOTOS - 1))
