"""Neighbours that mostly share an albedo: the pairs' weights, and what they do where photos alone cannot decide."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dante_w.traced.solver import smoothness_prior as evenness
from dante_w.traced.solver.smoothness_prior import smoothness_laplacian
from dante_w.traced.solver.solve_lights import solve_lights
from dante_w.traced.state import Components
from open_world import PHOTOS, World, make_world

#: What the prior is documented to be, written down here again: each point is paired with its 6 nearest and with 3 anywhere, which
#: count 0.15 of a near one; where all agree its pairs would count 10 together if all were near.
NEAR, FAR, PAIR, FAR_PAIR = 6, 3, 10.0 / 9.0, 0.15 * 10.0 / 9.0


def unevenness(position: np.ndarray, log_albedo: np.ndarray, of: np.ndarray) -> float:
    even = smoothness_laplacian(position, log_albedo, np.random.default_rng(0))
    return float(of @ (even @ torch.from_numpy(of.astype(np.float32))).numpy())


def test_it_is_the_weighted_sum_of_squared_differences_over_pairs():
    random = np.random.default_rng(1)
    position = random.normal(size=(40, 3))
    even = smoothness_laplacian(position, np.zeros((40, 3)), random).to_dense().numpy()
    np.testing.assert_allclose(even, even.T)
    np.testing.assert_allclose(even.sum(axis=1), 0.0, atol=1e-5)
    assert (even - np.diag(np.diag(even)) <= 0.0).all()
    apart = np.linalg.norm(position[:, None] - position, axis=2)
    nearest = np.argsort(apart, axis=1)[:, 1 : NEAR + 1]
    assert (even[np.arange(40)[:, None], nearest] < -0.99 * PAIR).all()


def test_points_anywhere_are_paired_too():
    """Two clusters far from each other: what ties them together are pairs with points anywhere."""
    random = np.random.default_rng(4)
    count = 200
    position = random.normal(size=(count, 3))
    position[count // 2 :] += 100.0
    even = smoothness_laplacian(position, np.zeros((count, 3)), random).to_dense().numpy()
    assert np.trace(even) == pytest.approx(2.0 * count * (NEAR * PAIR + FAR * FAR_PAIR), rel=1e-5)
    between = -even[: count // 2, count // 2 :].sum() / FAR_PAIR  # half of the partners anywhere
    assert between == pytest.approx(count * FAR / 2.0, rel=0.15)
    apart = np.where(np.arange(count) < count // 2, 0.0, 1.0)
    assert apart @ even @ apart == pytest.approx(between * FAR_PAIR, rel=1e-4)


def test_what_differs_in_colour_or_much_in_brightness_need_not_agree():
    position = np.random.default_rng(2).normal(size=(60, 3))
    two = np.arange(60) % 2
    step = two - 0.5
    same = unevenness(position, np.zeros((60, 3)), step)
    brighter = unevenness(position, two[:, None] * np.array([1.0, 1.0, 1.0]), step)
    redder = unevenness(position, two[:, None] * np.array([0.2, -0.1, -0.1]), step)
    assert brighter < 0.1 * same and redder < 0.1 * same
    assert unevenness(position, np.full((60, 3), 7.0), step) == pytest.approx(same, rel=1e-5)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_are_no_trouble(count):
    even = smoothness_laplacian(np.zeros((count, 3)), np.zeros((count, 3)), np.random.default_rng(3))
    assert even.shape == (count, count) and torch.isfinite(even.to_dense()).all()


def shading_left(world: World) -> float:
    """Rms of log albedo against the truth, after a gain per channel, with photos of one light alone."""
    light = np.zeros(PHOTOS, int)
    found = solve_lights(
        world.points,
        world.transfer,
        world.seen,
        world.cameras,
        light,
        0,
        lambda step, steps: None,
        Components(clusters=False),
        fine=False,
    )
    error = np.log(found.albedo[found.known]) - np.log(world.albedo[found.known])
    return float(np.sqrt(np.square(error - error.mean(axis=0)).mean()))


def test_under_one_light_shading_is_told_from_paint(monkeypatch):
    """Two materials on open points: without pairs, light is as the prior has it and its shading stays in the albedo."""
    world = make_world(lights=1, materials=2)
    with_pairs = shading_left(world)
    monkeypatch.setattr(evenness, "WEIGHT", 0.0)
    assert with_pairs < 0.5 * shading_left(world)
