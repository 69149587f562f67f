"""Lights by variable projection, on open points whose lights and albedo are known."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.traced.observations import Observations
from dante_w.traced.solver import levenberg_marquardt
from dante_w.traced.solver.normal_equations import Equations, gauss_newton_step
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import AlbedoPrior, Components, Lighting
from open_world import (
    BRIGHTEST,
    DIRECTIONS,
    LIGHTS,
    PHOTOS,
    POINTS,
    SETTINGS,
    TOP,
    World,
    albedo_error,
    make_world,
    solve,
    unit,
)

CLUSTER = np.arange(PHOTOS) % LIGHTS
#: How many photos have to see a point, and how far the method believes the scale that it finds: as documented, not imported.
FEWEST, CORRECTION = 3, 0.55
#: A fit that takes little time.
QUICK = dataclasses.replace(SETTINGS, coarse_directions=32, points_per_step=500)


def solved(
    world: World,
    observations: Observations | None = None,
    start: Lighting | None = None,
    **options: Any,
) -> Lighting:
    """Starting with each light split in two and one photo in the wrong cluster, unless other lights are given."""
    first = CLUSTER + LIGHTS * (np.arange(PHOTOS) >= PHOTOS // 2)
    first[0] = first[1]
    world = dataclasses.replace(world, observations=observations or world.observations)
    return solve(world, first if start is None else start, **options)


def assert_finite(lighting: Lighting) -> None:
    for name, value in vars(lighting).items():
        assert np.isfinite(value).all(), name


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def lighting(world: World) -> Lighting:
    return solved(world)


def test_albedo_is_recovered_up_to_a_gain(world, lighting):
    assert_finite(lighting)
    assert lighting.known.mean() > 0.9
    assert albedo_error(world, lighting) < 0.03
    assert np.quantile(lighting.albedo[lighting.known].max(axis=1), BRIGHTEST) == pytest.approx(
        lighting.brightest_albedo, rel=1e-3
    )
    assert lighting.brightest_albedo == pytest.approx(TOP, rel=0.05), (
        "as in the world: specular reflection tells it"
    )


def test_lights_go_on_from_a_fit_of_fewer_observations(world, lighting):
    coarse = solved(world, world.observations.take(world.observations.point % 4 == 0), fine=False)
    assert coarse.known.mean() < 0.3
    continued = solved(world, start=coarse)
    assert_finite(continued)
    assert (continued.known == lighting.known).all()
    assert albedo_error(world, continued) < 0.03
    assert len(continued.radiance) == len(coarse.radiance) == LIGHTS


def test_a_fit_goes_on_without_exposures():
    """Which were free, so that lights now have to take up what they had."""
    world = make_world(exposures=0.0)
    coarse = solved(world, fine=False)
    coarse = dataclasses.replace(
        coarse, log_exposure=coarse.log_exposure + 1.0, radiance=coarse.radiance / np.float32(np.e)
    )
    continued = solved(world, start=coarse, components=Components(exposures=False))
    assert np.ptp(continued.log_exposure) < 0.01
    assert albedo_error(world, continued) < 0.03 and not continued.setbacks


@pytest.mark.parametrize(("sides", "counts"), [(2, 1.0), (1, 1.0), (0.5, 2.0)])
def test_points_of_smaller_cells_count_more(world, monkeypatch, sides, counts):
    weights: set[float] = set()

    def step(equations: Equations, *others: Any) -> Any:
        weights.add(equations.point_weight)
        return gauss_newton_step(equations, *others)

    monkeypatch.setattr(levenberg_marquardt, "gauss_newton_step", step)
    settings = dataclasses.replace(QUICK, counted_side=sides * world.points.side)
    solved(world, settings=settings, fine=False)
    assert weights == {counts}


@pytest.mark.parametrize("top", [0.3, 0.7])
def test_specular_reflection_tells_the_scale_of_albedo(top):
    dark = make_world(top=top)
    lighting = solved(dark)
    correction = (
        np.log(lighting.brightest_albedo / TOP) / CORRECTION
    )  # it is right here, and believed in part
    assert correction == pytest.approx(np.log(top / TOP), abs=0.15)
    ratio = lighting.albedo[lighting.known].mean() / dark.albedo.mean()
    assert ratio == pytest.approx((TOP / top) ** (1.0 - CORRECTION), rel=0.1)


@pytest.mark.parametrize("top", [0.3, 0.7])
def test_bounced_light_tells_the_scale_of_albedo(top):
    """Of points without specular reflection, each lit by three others: darker ones reflect less onto each other."""
    world = make_world(matte=True, top=top, bounced=0.5)
    found = solved(world, components=Components(specular=False))
    correction = np.log(found.brightest_albedo / TOP) / CORRECTION
    assert correction == pytest.approx(np.log(top / TOP), abs=0.15)
    assert albedo_error(world, found) < 0.05


def test_each_light_is_found_once_and_relative_exposures_are_right(world, lighting):
    together = lighting.cluster[:, None] == lighting.cluster
    assert (together == (CLUSTER[:, None] == CLUSTER)).all()
    assert lighting.radiance.shape == (LIGHTS, DIRECTIONS, 3)
    for j in range(LIGHTS):
        mine = j == CLUSTER
        difference = lighting.log_exposure[mine] - world.exposure[mine]
        np.testing.assert_allclose(difference, difference.mean(), atol=0.02)


def test_the_model_explains_the_photos(world, lighting):
    observations = world.observations
    view = unit(world.cameras[observations.photo] - world.points.position[observations.point]).astype(
        np.float32
    )
    light = lighting.cluster[observations.photo]
    transport = world.transport
    specular = specular_radiance(
        observations.point,
        light,
        view,
        world.points.normal,
        transport,
        lighting.radiance,
    )
    irradiance = np.tensordot(transport.direct, lighting.radiance, axes=(1, 1)) + lighting.bounce
    gain = np.exp(lighting.log_exposure)[observations.photo, None]
    shown = gain * (lighting.albedo[observations.point] * irradiance[observations.point, light] + specular)
    rows = lighting.known[observations.point]
    error = np.log(shown[rows] / observations.colour[rows])
    assert np.sqrt(np.square(error).mean()) < 0.04


def test_without_light_solving_the_error_is_far_larger(world, lighting):
    """What the photos' mean would give: the bound above says something."""
    observations = world.observations
    total = np.bincount(observations.point, minlength=POINTS)
    shown = np.log(observations.colour) - world.exposure[observations.photo, None]
    mean = np.stack([np.bincount(observations.point, c, POINTS) for c in shown.T], axis=1)[lighting.known]
    error = mean / total[lighting.known, None] - np.log(world.albedo[lighting.known])
    assert np.sqrt(np.square(error - error.mean(axis=0)).mean()) > 5 * albedo_error(world, lighting)


def test_clipped_and_black_observations_are_survived(world):
    random = np.random.default_rng(7)
    colour = world.observations.colour.copy()
    fate = random.random(len(colour))
    colour[fate < 0.05] = 0.0
    colour[fate > 0.95] = 1.0
    observations = dataclasses.replace(world.observations, colour=colour, clipped=fate > 0.95)
    lighting = solved(world, observations)
    assert_finite(lighting)
    assert (lighting.albedo > 0.0).all()
    assert albedo_error(world, lighting) < 0.06


def test_a_point_that_too_few_photos_see_is_not_known(world, lighting):
    rows = np.ones(len(world.observations.point), bool)
    for point in range(50):
        rows[np.flatnonzero(world.observations.point == point)[FEWEST - 1 :]] = False
    rows[world.observations.point == 50] = False
    clipped = dataclasses.replace(
        world.observations, clipped=world.observations.point == 51
    )  # sees nothing either
    fewer = solved(world, clipped.take(rows))
    assert not fewer.known[:52].any() and lighting.known[:52].sum() > 40
    assert fewer.known[52:].tolist() == lighting.known[52:].tolist()
    assert_finite(fewer)
    np.testing.assert_allclose(fewer.albedo[:52], np.tile(fewer.albedo[0], (52, 1)))  # filled in


def test_same_seed_same_arrays(world):
    settings = dataclasses.replace(SETTINGS, points_per_step=400, fine_steps=1)
    first, second, other = (solved(world, settings=settings, seed=seed) for seed in (1, 1, 2))
    for name in vars(first):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)
    assert not np.array_equal(first.radiance, other.radiance)


def test_two_photos_are_divided_by_what_light_is_taken_for(world):
    lighting = solved(world, world.observations.take(world.observations.photo < FEWEST - 1))
    assert (
        lighting.known.any() and np.isfinite(lighting.radiance).all() and np.isfinite(lighting.albedo).all()
    )


def test_photos_that_are_all_clipped_are_bad_input(world):
    clipped = dataclasses.replace(world.observations, clipped=np.ones(len(world.observations.point), bool))
    with pytest.raises(BadInput, match="photos"):
        solved(world, clipped)


def test_without_the_fine_steps_light_comes_from_few_directions(world):
    coarse = solved(world, settings=QUICK, fine=False)
    assert coarse.radiance.shape == (LIGHTS, 32, 3)
    assert albedo_error(world, coarse) < 0.1


def test_components_that_are_off_are_not_modelled(world):
    components = Components(clusters=False, exposures=False, bounce=False)
    lighting = solved(world, settings=QUICK, components=components, fine=False)
    assert (lighting.cluster == 0).all() and len(lighting.radiance) == 1
    assert np.ptp(lighting.log_exposure) < 0.01
    assert not lighting.bounce.any()


def test_where_exposures_are_known_light_is_as_bright_as_photos_show(world):
    """Dusk is no long exposure: directions that photos say little of are not to be as bright as noon."""
    noon, dusk = (
        solved(
            world,
            dataclasses.replace(world.observations, colour=gain * world.observations.colour),
            fine=False,
            known_exposure=world.exposure,
        )
        for gain in (4.0, 0.25)
    )
    for lighting in (noon, dusk):
        assert albedo_error(world, lighting) < 0.05
        assert np.abs(lighting.log_exposure - world.exposure).max() < 0.2
    assert np.log(noon.radiance.mean() / dusk.radiance.mean()) == pytest.approx(np.log(16.0), abs=0.2)


def test_exposures_from_files_are_taken_where_photos_do_not_tell(world):
    """Photos of one light tell their exposures apart, but not a bright light from a long exposure."""
    among = np.array([0.5, -0.2, -0.3])
    known = world.exposure + among[CLUSTER] + np.where(CLUSTER == 0, 0.0, 0.05 * np.sign(world.exposure))
    lighting = solved(world, settings=QUICK, fine=False, known_exposure=known)
    off = lighting.log_exposure - world.exposure
    for j in range(LIGHTS):
        np.testing.assert_allclose(off[j == CLUSTER], off[j == CLUSTER].mean(), atol=0.03)
    between = np.array([off[j == CLUSTER].mean() for j in range(LIGHTS)])
    np.testing.assert_allclose(between - between.mean(), among, atol=0.1)


def test_an_albedo_prior_sets_scale_and_white_balance(world, lighting):
    gain = np.array([1.5, 1.2, 0.9])
    random = np.random.default_rng(8)
    log_albedo = np.log(world.albedo * gain) + random.normal(0.0, 0.2, world.albedo.shape)
    weight = np.where(np.arange(POINTS) % 3 == 0, 0.0, 0.25).astype(np.float32)
    with_prior = solved(world, albedo_prior=AlbedoPrior(log_albedo.astype(np.float32), weight))
    off = np.log(with_prior.albedo / world.albedo)[with_prior.known]
    np.testing.assert_allclose(off.mean(axis=0), np.log(gain), atol=0.05)
    assert albedo_error(world, with_prior) < 0.05, "photos decide on the rest"
    nothing = solved(world, albedo_prior=AlbedoPrior(log_albedo.astype(np.float32), 0.0 * weight))
    np.testing.assert_array_equal(nothing.albedo, lighting.albedo)
