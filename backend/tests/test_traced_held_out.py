"""Photos that lights were not solved from: placed under the light that is theirs, and scored."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dante_w.traced.held_out import fit_held_out
from dante_w.traced.observations import Observations
from dante_w.traced.state import Components, Lighting, TracedScene
from open_world import LIGHTS, PHOTOS, POINTS, World, make_world, solve

HELD_OUT = np.array([4, 11])
PARTS = Components(bounce=False)


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


@pytest.fixture(scope="module")
def lights(world: World) -> Lighting:
    """Solved without the held-out photos, which are as if under light 0."""
    seen = world.observations.take(~np.isin(world.observations.photo, HELD_OUT))
    cluster = world.cluster.copy()
    cluster[HELD_OUT] = 0
    return solve(dataclasses.replace(world, observations=seen), cluster, components=PARTS)


def scene_of(world: World, seen: Observations) -> TracedScene:
    return TracedScene(world.cameras, world.points, seen, world.transport, None, None, world.cluster)


def placed(
    world: World, lights: Lighting, parts: Components = PARTS, **changed
) -> tuple[Lighting, float | None]:
    seen = dataclasses.replace(world.observations, **changed)
    return fit_held_out(lights, scene_of(world, seen), HELD_OUT, parts)


def test_they_get_their_light_and_exposure(world, lights):
    found, score = placed(world, lights)
    assert found.cluster[HELD_OUT].tolist() == world.cluster[HELD_OUT].tolist() == [1, 2]
    off = found.log_exposure - world.exposure
    for photo in HELD_OUT:
        mine = (world.cluster == world.cluster[photo]) & ~np.isin(np.arange(PHOTOS), HELD_OUT)
        assert off[photo] == pytest.approx(off[mine].mean(), abs=0.03)
    others = ~np.isin(np.arange(PHOTOS), HELD_OUT)
    assert (found.cluster[others] == lights.cluster[others]).all()
    assert (found.log_exposure[others] == lights.log_exposure[others]).all()
    # colours carry noise of 3%: in sRGB some 35 dB
    assert score is not None and 30.0 < score < 45.0


def test_the_score_is_of_what_was_not_fitted(world, lights):
    """Rows of cells take turns: what the others show can be spoilt without the placing taking note."""
    cell = np.flatnonzero(world.points.point_of_cell >= 0)
    scored = (cell // 256 // 8 % 2 == 1)[world.observations.point]
    spoilt, low = placed(
        world, lights, colour=np.where(scored[:, None], np.float32(0.9), world.observations.colour)
    )
    clean, high = placed(world, lights)
    np.testing.assert_array_equal(spoilt.log_exposure, clean.log_exposure)
    assert low is not None and high is not None and low < high - 10.0


def test_a_photo_that_fares_badly_counts_as_one(world, lights):
    """The score is the mean of the photos' own; by summed squares the worst would decide."""
    noise = np.random.default_rng(0).normal(0.0, 0.5, world.observations.colour.shape)
    spoilt = world.observations.colour * np.exp(
        np.where((world.observations.photo == HELD_OUT[0])[:, None], noise, 0.0)
    )
    seen = dataclasses.replace(world.observations, colour=spoilt.astype(np.float32))
    scene = scene_of(world, seen)
    bad, good = (fit_held_out(lights, scene, HELD_OUT[[index]], PARTS)[1] for index in (0, 1))
    both = fit_held_out(lights, scene, HELD_OUT, PARTS)[1]
    assert both == pytest.approx((bad + good) / 2.0) and good > bad + 6.0


def test_a_wrong_albedo_costs(world, lights):
    wrong = dataclasses.replace(lights, albedo=lights.albedo[np.random.default_rng(0).permutation(POINTS)])
    good, bad = (placed(world, each)[1] for each in (lights, wrong))
    assert good is not None and bad is not None and bad < good - 10.0


def test_exposures_that_are_one_for_all_are_not_fitted(world, lights):
    found, score = placed(world, lights, dataclasses.replace(PARTS, exposures=False))
    np.testing.assert_allclose(found.log_exposure[HELD_OUT], np.median(lights.log_exposure))
    fitted = placed(world, lights)[1]
    assert score is not None and fitted is not None and score < fitted - 3.0


def test_without_specular_matte_photos_are_explained_worse(world, lights):
    score = placed(world, lights, dataclasses.replace(PARTS, specular=False))[1]
    fitted = placed(world, lights)[1]
    assert score is not None and fitted is not None and score < fitted - 0.5


def test_nothing_to_score(world, lights):
    for changed in (
        {"clipped": np.ones(len(world.observations.point), bool)},
        {"photo": 0 * world.observations.photo},
    ):
        found, score = placed(world, lights, **changed)
        assert score is None
        assert found.cluster[HELD_OUT].tolist() == [0, 0] and len(found.radiance) == LIGHTS
