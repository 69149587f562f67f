"""Lights by variable projection, on open points whose lights and albedo are known."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.traced.observations import Observations
from dante_w.traced.solver.normal_equations import Equations, step
from dante_w.traced.solver.solve_lights import BRIGHTEST, FEWEST_PHOTOS, LEVEL_TRUST, TOP, solve_lights
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import AlbedoPrior, Components, Lighting
from open_world import DIRECTIONS, LIGHTS, PHOTOS, POINTS, World, make_world, unit

LIGHT = np.arange(PHOTOS) % LIGHTS


def solved(world: World, seen: Observations | None = None, seed: int = 0, **options: Any) -> Lighting:
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
        **options,
    )
    assert [step for step, _ in said] == list(range(1, said[-1][1] + 1))
    return found


def albedo_error(world: World, found: Lighting) -> float:
    """Rms of log albedo at known points, after one gain per channel."""
    error = np.log(found.albedo[found.known]) - np.log(world.albedo[found.known])
    return float(np.sqrt(np.square(error - error.mean(axis=0)).mean()))


def assert_finite(found: Lighting) -> None:
    for name, value in vars(found).items():
        assert np.isfinite(value).all(), name


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def found(world: World) -> Lighting:
    return solved(world)


def test_albedo_is_recovered_up_to_a_gain(world, found):
    assert_finite(found)
    assert found.known.mean() > 0.9
    assert albedo_error(world, found) < 0.03
    assert np.quantile(found.albedo[found.known].max(axis=1), BRIGHTEST) == pytest.approx(
        found.brightest_albedo, rel=1e-3
    )
    assert found.brightest_albedo == pytest.approx(TOP, rel=0.05), "as in the world: sheen tells"


def test_lights_go_on_from_a_fit_of_fewer_observations(world, found):
    begun = solved(world, world.seen.take(world.seen.point % 4 == 0), fine=False)
    assert begun.known.mean() < 0.3
    again = solved(world, begun=begun)
    assert_finite(again)
    assert (again.known == found.known).all()
    assert albedo_error(world, again) < 0.03
    assert len(again.radiance) == len(begun.radiance) == LIGHTS


def test_a_fit_goes_on_without_exposures():
    """Which were free, so that lights now have to take up their levels."""
    world = make_world(exposures=0.0)
    begun = solved(world, fine=False)
    begun = dataclasses.replace(
        begun, log_exposure=begun.log_exposure + 1.0, radiance=begun.radiance / np.float32(np.e)
    )
    again = solved(world, begun=begun, parts=Components(exposures=False))
    assert np.ptp(again.log_exposure) < 0.01
    assert albedo_error(world, again) < 0.03 and not again.setbacks


@pytest.mark.parametrize(("sides", "counts"), [(2, 1.0), (1, 1.0), (0.5, 2.0)])
def test_points_of_smaller_cells_count_more(world, monkeypatch, sides, counts):
    seen: set[float] = set()

    def steps(equations: Equations, *others: Any) -> Any:
        seen.add(equations.counts)
        return step(equations, *others)

    monkeypatch.setattr("dante_w.traced.solver.solve_lights.COUNTED_SIDE", sides * world.points.side)
    monkeypatch.setattr("dante_w.traced.solver.solve_lights.step", steps)
    solved(world, fine=False)
    assert seen == {counts}


@pytest.mark.parametrize("top", [0.3, 0.7])
def test_sheen_tells_the_level_of_albedo(top):
    dark = make_world(top=top)
    found = solved(dark)
    told = np.log(found.brightest_albedo / TOP) / LEVEL_TRUST  # it is told whole here, and believed in part
    assert told == pytest.approx(np.log(top / TOP), abs=0.15)
    ratio = found.albedo[found.known].mean() / dark.albedo.mean()
    assert ratio == pytest.approx((TOP / top) ** (1.0 - LEVEL_TRUST), rel=0.1)


def test_each_light_is_found_once_and_relative_exposures_are_right(world, found):
    together = found.cluster[:, None] == found.cluster
    assert (together == (LIGHT[:, None] == LIGHT)).all()
    assert found.radiance.shape == (LIGHTS, DIRECTIONS, 3)
    for j in range(LIGHTS):
        mine = j == LIGHT
        difference = found.log_exposure[mine] - world.exposure[mine]
        np.testing.assert_allclose(difference, difference.mean(), atol=0.02)


def test_the_model_explains_the_photos(world, found):
    seen = world.seen
    towards = unit(world.cameras[seen.photo] - world.points.position[seen.point]).astype(np.float32)
    light = found.cluster[seen.photo]
    transfer = world.transfer
    gloss = specular_radiance(
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
    fewer = solved(world, clipped.take(rows))
    assert not fewer.known[:52].any() and found.known[:52].sum() > 40
    assert fewer.known[52:].tolist() == found.known[52:].tolist()
    assert_finite(fewer)
    np.testing.assert_allclose(fewer.albedo[:52], np.tile(fewer.albedo[0], (52, 1)))  # filled in


def test_same_seed_same_arrays(world, monkeypatch):
    monkeypatch.setattr("dante_w.traced.solver.solve_lights.POINTS", 400)
    monkeypatch.setattr("dante_w.traced.solver.solve_lights.LAST_STEPS", 1)
    first, again, other = (solved(world, seed=seed) for seed in (1, 1, 2))
    for name in vars(first):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name), name)
    assert not np.array_equal(first.radiance, other.radiance)


def test_two_photos_are_divided_by_what_light_is_taken_for(world):
    found = solved(world, world.seen.take(world.seen.photo < FEWEST_PHOTOS - 1))
    assert found.known.any() and np.isfinite(found.radiance).all() and np.isfinite(found.albedo).all()


def test_photos_that_are_all_clipped_are_bad_input(world):
    clipped = dataclasses.replace(world.seen, clipped=np.ones(len(world.seen.point), bool))
    with pytest.raises(BadInput, match="photos"):
        solved(world, clipped)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("dante_w.traced.solver.solve_lights.COARSE", 32)
    monkeypatch.setattr("dante_w.traced.solver.solve_lights.POINTS", 500)


def test_without_the_last_steps_light_comes_from_few_directions(world, quick):
    coarse = solved(world, fine=False)
    assert coarse.radiance.shape == (LIGHTS, 32, 3)
    assert albedo_error(world, coarse) < 0.1


def test_parts_that_are_off_are_not_modelled(world, quick):
    found = solved(world, parts=Components(clusters=False, exposures=False, bounce=False), fine=False)
    assert (found.cluster == 0).all() and len(found.radiance) == 1
    assert np.ptp(found.log_exposure) < 0.01
    assert not found.bounce.any()


def test_where_exposures_are_known_light_has_the_level(world):
    """Dusk is no long exposure: directions that photos say little of are not to be as bright as noon."""
    noon, dusk = (
        solved(
            world,
            dataclasses.replace(world.seen, colour=gain * world.seen.colour),
            fine=False,
            known_exposure=world.exposure,
        )
        for gain in (4.0, 0.25)
    )
    for found in (noon, dusk):
        assert albedo_error(world, found) < 0.05
        assert np.abs(found.log_exposure - world.exposure).max() < 0.2
    assert np.log(noon.radiance.mean() / dusk.radiance.mean()) == pytest.approx(np.log(16.0), abs=0.2)


def test_files_tell_the_exposures_where_photos_do_not(world, quick):
    """Photos of one light tell their exposures apart, but not a bright light from a long exposure."""
    among = np.array([0.5, -0.2, -0.3])
    known = world.exposure + among[LIGHT] + np.where(LIGHT == 0, 0.0, 0.05 * np.sign(world.exposure))
    found = solved(world, fine=False, known_exposure=known)
    off = found.log_exposure - world.exposure
    for j in range(LIGHTS):
        np.testing.assert_allclose(off[j == LIGHT], off[j == LIGHT].mean(), atol=0.03)
    between = np.array([off[j == LIGHT].mean() for j in range(LIGHTS)])
    np.testing.assert_allclose(between - between.mean(), among, atol=0.1)


def test_a_prior_sets_level_and_tint(world, found):
    gain = np.array([1.5, 1.2, 0.9])
    random = np.random.default_rng(8)
    log_albedo = np.log(world.albedo * gain) + random.normal(0.0, 0.2, world.albedo.shape)
    trust = np.where(np.arange(POINTS) % 3 == 0, 0.0, 0.25).astype(np.float32)
    told = solved(world, prior=AlbedoPrior(log_albedo.astype(np.float32), trust))
    off = np.log(told.albedo / world.albedo)[told.known]
    np.testing.assert_allclose(off.mean(axis=0), np.log(gain), atol=0.05)
    assert albedo_error(world, told) < 0.05, "photos decide on the rest"
    nothing = solved(world, prior=AlbedoPrior(log_albedo.astype(np.float32), 0.0 * trust))
    np.testing.assert_array_equal(nothing.albedo, found.albedo)
