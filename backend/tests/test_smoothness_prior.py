"""The smoothness prior: the weights of its pairs, and what they do where photos alone cannot decide."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from dante_w.traced.solver.smoothness_prior import smoothness_laplacian
from dante_w.traced.state import Components
from open_world import PHOTOS, SETTINGS, albedo_error, make_world, solve

#: What the prior is documented to be, written down here again: each point is paired with its 6 nearest and with 3 anywhere, which
#: count 0.15 of a near one; where all agree its pairs would count 10 together if all were near.
NEAR, FAR, PAIR, FAR_PAIR = 6, 3, 10.0 / 9.0, 0.15 * 10.0 / 9.0


def laplacian(
    position: np.ndarray, log_albedo: np.ndarray, random: np.random.Generator | None = None
) -> torch.Tensor:
    return smoothness_laplacian(position, log_albedo, random or np.random.default_rng(0), SETTINGS.smoothness)


def roughness(position: np.ndarray, log_albedo: np.ndarray, values: np.ndarray) -> float:
    return float(
        values @ (laplacian(position, log_albedo) @ torch.from_numpy(values.astype(np.float32))).numpy()
    )


def test_it_is_the_weighted_sum_of_squared_differences_over_pairs():
    random = np.random.default_rng(1)
    position = random.normal(size=(40, 3))
    matrix = laplacian(position, np.zeros((40, 3)), random).to_dense().numpy()
    np.testing.assert_allclose(matrix, matrix.T)
    np.testing.assert_allclose(matrix.sum(axis=1), 0.0, atol=1e-5)
    assert (matrix - np.diag(np.diag(matrix)) <= 0.0).all()
    distance = np.linalg.norm(position[:, None] - position, axis=2)
    nearest = np.argsort(distance, axis=1)[:, 1 : NEAR + 1]
    assert (matrix[np.arange(40)[:, None], nearest] < -0.99 * PAIR).all()


def test_points_anywhere_are_paired_too():
    """Two clusters far from each other: what ties them together are pairs with points anywhere."""
    random = np.random.default_rng(4)
    count = 200
    position = random.normal(size=(count, 3))
    position[count // 2 :] += 100.0
    matrix = laplacian(position, np.zeros((count, 3)), random).to_dense().numpy()
    assert np.trace(matrix) == pytest.approx(2.0 * count * (NEAR * PAIR + FAR * FAR_PAIR), rel=1e-5)
    between = -matrix[: count // 2, count // 2 :].sum() / FAR_PAIR  # half of the partners anywhere
    assert between == pytest.approx(count * FAR / 2.0, rel=0.15)
    step = np.where(np.arange(count) < count // 2, 0.0, 1.0)
    assert step @ matrix @ step == pytest.approx(between * FAR_PAIR, rel=1e-4)


def test_what_differs_in_colour_or_much_in_brightness_need_not_agree():
    position = np.random.default_rng(2).normal(size=(60, 3))
    two = np.arange(60) % 2
    step = two - 0.5
    same = roughness(position, np.zeros((60, 3)), step)
    brighter = roughness(position, two[:, None] * np.array([1.0, 1.0, 1.0]), step)
    redder = roughness(position, two[:, None] * np.array([0.2, -0.1, -0.1]), step)
    assert brighter < 0.1 * same and redder < 0.1 * same
    assert roughness(position, np.full((60, 3), 7.0), step) == pytest.approx(same, rel=1e-5)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_are_no_trouble(count):
    matrix = laplacian(np.zeros((count, 3)), np.zeros((count, 3)), np.random.default_rng(3))
    assert matrix.shape == (count, count) and torch.isfinite(matrix.to_dense()).all()


def test_under_one_light_shading_is_told_from_paint():
    """Two materials on open points: without pairs, light is as its prior has it and its shading stays in the albedo."""
    world, one = make_world(lights=1, materials=2), np.zeros(PHOTOS, int)
    without = dataclasses.replace(SETTINGS.smoothness, weight=0.0)
    with_pairs, without_pairs = (
        albedo_error(world, solve(world, one, settings, components=Components(clusters=False), fine=False))
        for settings in (SETTINGS, dataclasses.replace(SETTINGS, smoothness=without))
    )
    assert with_pairs < 0.5 * without_pairs
