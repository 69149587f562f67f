"""The albedo under given lights against the same written out in float64, row by row."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.traced.solver.variable_projection import (
    FAINTEST,
    FARTHEST,
    LEAST_DIFFUSE,
    OUTLIER,
    by_point,
    project_albedo,
)


def some(observations: int, points: int, photos: int, lights: int, seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    point = random.integers(0, points, observations).astype(np.int32)
    point[point == 1] = 0  # nothing shows the second one
    order, ends = by_point(point, points)
    return {
        "order": order,
        "ends": ends,
        "log_colour": random.normal(-1.5, 1.0, (observations, 3)).astype(np.float32),
        "weight": random.choice([0.0, 0.5, 2.0], (observations, 3)).astype(np.float32),
        "gloss": random.uniform(0.0, 0.3, (observations, 3)).astype(np.float32),
        "photo": np.sort(random.integers(0, photos, observations)).astype(np.int32),
        "log_exposure": random.normal(0.0, 0.5, photos).astype(np.float32),
        "light": random.integers(0, lights, photos),
        "irradiance": random.uniform(0.05, 2.0, (points, lights, 3)).astype(np.float32),
        "prior": random.normal(-1.0, 0.3, (points, 3)).astype(np.float32),
        "prior_trust": random.choice([0.0, 3.0], points).astype(np.float32),
        "point": point,
    }


def reference(of: dict[str, np.ndarray], cold: bool, log_albedo: np.ndarray) -> list[np.ndarray]:
    point, count = of["point"], len(log_albedo)
    light = of["irradiance"].astype(np.float64)[point, of["light"][of["photo"]]]
    shown = of["log_colour"].astype(np.float64) - of["log_exposure"][of["photo"], None]
    known, gloss = of["prior_trust"][:, None].astype(np.float64), of["gloss"].astype(np.float64)
    log_albedo = log_albedo.astype(np.float64)
    for turn in range(2):
        if cold and turn == 0:
            share, over = np.ones_like(shown), shown - np.log(light)
        else:
            diffuse = np.exp(log_albedo)[point] * light
            share = np.maximum(diffuse / (diffuse + gloss), LEAST_DIFFUSE)
            off = (shown - np.log(diffuse + gloss)) / share
            over = log_albedo[point] + off.clip(-FARTHEST, FARTHEST)
        weight = of["weight"] * share**2
        trust = weight
        for _ in range(2):
            told, total = np.zeros((count, 3)), np.zeros((count, 3))
            np.add.at(told, point, trust * over)
            np.add.at(total, point, trust)
            log_albedo = (told + known * of["prior"]) / (total + known + 1e-9)
            residual = over - log_albedo[point]
            trust = weight / (1.0 + (share * residual / OUTLIER) ** 2)
        log_albedo = np.maximum(log_albedo, np.log(FAINTEST))
    return [log_albedo, over, trust, residual, share]


@pytest.mark.parametrize("cold", [True, False])
@pytest.mark.parametrize("observations", [1, 3000])
def test_it_is_the_same_written_out_in_float64(cold, observations):
    of = some(observations, 60, 9, 3, seed=1)
    first = np.zeros((60, 3)) if cold else np.random.default_rng(2).normal(-1.0, 0.5, (60, 3))
    expected = reference(of, cold, first.astype(np.float32))
    log_albedo = first.astype(np.float32)
    out = [np.empty((observations, 3), np.float32) for _ in range(4)]
    arrays = [array for name, array in of.items() if name != "point"]
    project_albedo(*arrays, cold, log_albedo, *out)
    for found, exact in zip([log_albedo, *out], expected, strict=True):
        np.testing.assert_allclose(found, exact, rtol=2e-4, atol=2e-5)


def test_rows_are_sorted_by_point_and_keep_their_order():
    point = np.array([2, 0, 2, 5, 0, 2], np.int32)
    order, ends = by_point(point, 6)
    assert order.tolist() == [1, 4, 0, 2, 5, 3]
    assert ends.tolist() == [0, 2, 2, 5, 5, 5, 6]
