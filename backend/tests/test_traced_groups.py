"""Which photos share a light, on colours made for it."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.traced import light_clusters
from dante_w.traced.light_clusters import (
    USUAL_CLUSTERS,
    ClusterSettings,
    _average_linkage,
    first_clusters,
    reassign_photos,
)
from dante_w.traced.observations import Observations
from dante_w.traced.state import Lighting

LIGHTS, EACH, POINTS = 3, 4, 800
PHOTOS = LIGHTS * EACH
TRUTH = np.arange(PHOTOS) % LIGHTS


def same_partition(a, b):
    """Whether two labellings put the same things together."""
    return ((a[:, None] == a) == (b[:, None] == b)).all()


def pure(light, truth=TRUTH):
    return all(len(np.unique(truth[light == j])) == 1 for j in np.unique(light))


@pytest.fixture
def world():
    """Log irradiance (C, J, 3), log albedo (C, 3), exposures (K,), and observations of bumpy points."""
    random = np.random.default_rng(2)
    normals = random.normal(size=(POINTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    towards = np.array([(1.0, 0.0, 0.5), (-0.7, 0.7, 0.5), (-0.2, -1.0, 0.3)])
    tint = np.array([(1.0, 0.9, 0.7), (0.8, 0.9, 1.0), (1.0, 1.0, 1.0)])
    irradiance = np.exp(normals @ towards.T)[:, :, None] * tint
    albedo = random.uniform(0.1, 0.8, (POINTS, 3))
    exposure = random.normal(0.0, 0.5, PHOTOS)
    photo, point = np.nonzero(random.random((PHOTOS, POINTS)) < 0.7)
    colour = np.exp(exposure)[photo, None] * albedo[point] * irradiance[point, TRUTH[photo]] * 0.3
    colour *= np.exp(random.normal(0.0, 0.02, colour.shape))
    count = len(photo)
    seen = Observations(
        point.astype(np.int32),
        photo.astype(np.int32),
        colour.astype(np.float32),
        np.ones(count, np.int32),
        np.zeros(count, bool),
    )
    return np.log(irradiance), np.log(albedo), exposure + np.log(0.3), seen


def moved(world, light, log_irradiance, as_good=1.25):
    _, log_albedo, exposure, seen = world
    target = np.log(seen.colour) - exposure[seen.photo, None]
    weight = np.ones_like(target)
    known, nothing = np.ones(POINTS, bool), np.zeros(0)
    lighting = Lighting(nothing, light, exposure, nothing, np.exp(log_albedo), known, brightest_albedo=0.5)
    return reassign_photos(target, np.exp(log_irradiance), weight, seen, lighting, as_good)


def test_linkage_finds_obvious_clusters():
    random = np.random.default_rng(3)
    truth = random.permutation(np.repeat([0, 1, 2], [3, 5, 1]))
    noise = random.uniform(0.0, 0.1, (9, 9))
    apart = np.where(truth[:, None] == truth, 0.1, 1.0) + noise + noise.T
    np.fill_diagonal(apart, 0.0)
    found = _average_linkage(apart, 3, 1.0)
    assert same_partition(found, truth)
    assert sorted(set(found.tolist())) == [0, 1, 2]
    assert len(set(_average_linkage(apart, 5, 1.0).tolist())) == 5
    assert _average_linkage(apart, 20, 1.0).tolist() == list(range(9))
    assert (_average_linkage(apart, 1, 1.0) == 0).all()


def test_linkage_takes_the_mean_of_all_members():
    # on a line: 0, 1 | 4; then 7.2 joins 4 (3.2) and not the pair
    place = np.array([0.0, 1.0, 4.0, 7.2])
    found = _average_linkage(np.abs(place[:, None] - place), 2, 1.0)
    assert same_partition(found, np.array([0, 0, 1, 1]))
    # single linkage would chain 0, 1, 2.1, 3.3 together first
    place = np.array([0.0, 1.0, 2.1, 3.3])
    found = _average_linkage(np.abs(place[:, None] - place), 2, 1.0)
    assert same_partition(found, np.array([0, 0, 1, 1]))


def test_first_clusters_are_pure(world):
    seen = world[3]
    found = first_clusters(seen, POINTS, PHOTOS)
    assert found.shape == (PHOTOS,) and pure(found)
    assert len(np.unique(found)) == USUAL_CLUSTERS.clusters
    few = ClusterSettings(clusters=LIGHTS)
    assert same_partition(first_clusters(seen, POINTS, PHOTOS, few), TRUTH)


def test_linkage_passes_over_what_is_not_known():
    # photos 0 to 3 along a wall, each overlapping the next; 4 and 5, of another light, overlap all of 0 and 1
    apart, known = np.full((6, 6), 1.0), np.zeros((6, 6), bool)
    near, far = [(0, 1), (1, 2), (2, 3), (4, 5)], [(0, 4), (0, 5), (1, 4), (1, 5)]
    for (i, j), distance in [*((pair, 0.1) for pair in near), *((pair, 0.3) for pair in far)]:
        apart[i, j] = apart[j, i] = distance
        known[i, j] = known[j, i] = True
    found = _average_linkage(apart, 2, 1.0, known)
    assert same_partition(found, np.array([0, 0, 0, 0, 1, 1]))
    assert not same_partition(_average_linkage(apart, 2, 1.0), np.array([0, 0, 0, 0, 1, 1]))
    assert len(np.unique(_average_linkage(apart, 2, 1.0, np.zeros((6, 6), bool)))) == 2


@pytest.mark.parametrize("count", [6, 9])
def test_of_many_photos_some_are_compared_with_all(world, count):
    settings = ClusterSettings(clusters=LIGHTS, compared=count)
    assert same_partition(first_clusters(world[3], POINTS, PHOTOS, settings), TRUTH)


def test_clipped_and_dark_observations_do_not_group(world):
    seen = world[3]
    random = np.random.default_rng(4)
    bad = random.random(len(seen.point)) < 0.2
    colour = np.where(bad[:, None], 1.0, seen.colour).astype(np.float32)
    colour[bad & (seen.point % 2 == 0)] = 0.0
    clipped = bad & (seen.point % 2 == 1)
    spoilt = Observations(seen.point, seen.photo, colour, seen.pixels, clipped)
    few = ClusterSettings(clusters=LIGHTS)
    assert same_partition(first_clusters(spoilt, POINTS, PHOTOS, few), TRUTH)


def test_photos_without_common_points_still_get_a_group(world):
    seen = world[3]
    found = first_clusters(seen.take(seen.point % PHOTOS == seen.photo), POINTS, PHOTOS)
    assert found.shape == (PHOTOS,) and len(np.unique(found)) == USUAL_CLUSTERS.clusters
    assert (first_clusters(seen.take(seen.photo == 0), POINTS, 1) == 0).all()


def test_a_misplaced_photo_moves(world):
    light = TRUTH.copy()
    light[[1, 5]] = 0, 0
    found, kept = moved(world, light, world[0])
    assert found.tolist() == TRUTH.tolist() and kept.tolist() == [0, 1, 2]


def test_lights_that_are_the_same_become_one(world):
    light = TRUTH.copy()
    light[[0, 3]] = 3
    twice = np.concatenate([world[0], world[0][:, :1] + 0.01], axis=1)
    found, kept = moved(world, light, twice)
    assert same_partition(found, TRUTH)
    assert len(kept) == 3 and {1, 2} <= set(kept.tolist())
    assert sorted(set(found.tolist())) == [0, 1, 2], "renumbered without a gap"


def test_different_lights_stay_apart(world):
    found, kept = moved(world, TRUTH.copy(), world[0])
    assert found.tolist() == TRUTH.tolist() and kept.tolist() == [0, 1, 2]


@pytest.mark.parametrize("as_good, lights", [(1.25, 2), (1.4, 1)])
def test_a_photo_that_nothing_explains_does_not_join_lights(world, monkeypatch, as_good, lights):
    # two photos want light 0, one wants light 1, and a spoilt one neither
    residual = np.array([(0.02, 0.03), (0.02, 0.03), (0.30, 0.30), (0.05, 0.02)])
    monkeypatch.setattr(light_clusters, "_residuals", lambda *_: (residual, np.ones(4, bool)))
    found, kept = moved(world, np.array([0, 0, 0, 1]), world[0][:, :2], as_good)
    assert len(kept) == lights, "the ratio of the sums is 1.06, the mean ratio 1.31"
    assert found.tolist() == ([0, 0, 0, 1] if lights == 2 else [0, 0, 0, 0])


def test_a_photo_that_saw_nothing_keeps_a_light(world):
    log_irradiance, log_albedo, exposure, seen = world
    some = seen.take(seen.photo != 7)
    found, kept = moved((log_irradiance, log_albedo, exposure, some), TRUTH.copy(), log_irradiance)
    assert same_partition(found, TRUTH) and found.max() < len(kept)


def test_a_light_whose_photos_saw_nothing_is_given_up(world):
    log_irradiance, log_albedo, exposure, seen = world
    light = TRUTH.copy()
    light[7] = 3
    four = np.concatenate([log_irradiance, log_irradiance[:, :1] + 0.5], axis=1)
    found, kept = moved((four, log_albedo, exposure, seen.take(seen.photo != 7)), light, four)
    assert kept.tolist() == [0, 1, 2] and found.max() == 2
    others = np.arange(PHOTOS) != 7
    assert found[others].tolist() == TRUTH[others].tolist()
