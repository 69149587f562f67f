"""The albedo under given lights against the same written out in float64, row by row."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.traced.solver.evidence import rows_by_point
from dante_w.traced.solver.variable_projection import project_points
from dante_w.traced.state import FAINTEST

#: What the method is documented to assume, written down here again: the residual that loses half its weight, the least diffuse
#: fraction, the farthest opinion.
OUTLIER, LEAST_DIFFUSE, FARTHEST = 0.15, 0.05, 1.5


def some(observations: int, points: int, photos: int, lights: int, seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    point = random.integers(0, points, observations).astype(np.int32)
    point[point == 1] = 0  # nothing shows the second one
    order, ends = rows_by_point(point, points)
    return {
        "order": order,
        "ends": ends,
        "log_colour": random.normal(-1.5, 1.0, (observations, 3)).astype(np.float32),
        "weight": random.choice([0.0, 0.5, 2.0], (observations, 3)).astype(np.float32),
        "specular": random.uniform(0.0, 0.3, (observations, 3)).astype(np.float32),
        "photo": np.sort(random.integers(0, photos, observations)).astype(np.int32),
        "log_exposure": random.normal(0.0, 0.5, photos).astype(np.float32),
        "cluster": random.integers(0, lights, photos),
        "irradiance": random.uniform(0.05, 2.0, (points, lights, 3)).astype(np.float32),
        "prior": random.normal(-1.0, 0.3, (points, 3)).astype(np.float32),
        "prior_weight": random.choice([0.0, 3.0], points).astype(np.float32),
        "point": point,
    }


def reference(arrays: dict[str, np.ndarray], first: bool, log_albedo: np.ndarray) -> list[np.ndarray]:
    point, count = arrays["point"], len(log_albedo)
    light = arrays["irradiance"].astype(np.float64)[point, arrays["cluster"][arrays["photo"]]]
    shown = arrays["log_colour"].astype(np.float64) - arrays["log_exposure"][arrays["photo"], None]
    known, specular = (arrays[name].astype(np.float64) for name in ("prior_weight", "specular"))
    known = known[:, None]
    log_albedo = log_albedo.astype(np.float64)
    for turn in range(2):
        if first and turn == 0:
            share, over = np.ones_like(shown), shown - np.log(light)
        else:
            diffuse = np.exp(log_albedo)[point] * light
            share = np.maximum(diffuse / (diffuse + specular), LEAST_DIFFUSE)
            off = (shown - np.log(diffuse + specular)) / share
            over = log_albedo[point] + off.clip(-FARTHEST, FARTHEST)
        weight = arrays["weight"] * share**2
        robust = weight
        for _ in range(2):
            weighted, total = np.zeros((count, 3)), np.zeros((count, 3))
            np.add.at(weighted, point, robust * over)
            np.add.at(total, point, robust)
            log_albedo = (weighted + known * arrays["prior"]) / (total + known + 1e-9)
            residual = over - log_albedo[point]
            robust = weight / (1.0 + (share * residual / OUTLIER) ** 2)
        log_albedo = np.maximum(log_albedo, np.log(FAINTEST))
    return [log_albedo, over, robust, residual, share]


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("observations", [1, 3000])
def test_it_is_the_same_written_out_in_float64(first, observations):
    arrays = some(observations, 60, 9, 3, seed=1)
    before = np.zeros((60, 3)) if first else np.random.default_rng(2).normal(-1.0, 0.5, (60, 3))
    expected = reference(arrays, first, before.astype(np.float32))
    log_albedo = before.astype(np.float32)
    out = [np.empty((observations, 3), np.float32) for _ in range(4)]
    numbers = np.float32(1.0 / OUTLIER), np.float32(LEAST_DIFFUSE), np.float32(FARTHEST), 2, 2
    del arrays["point"]
    project_points(*arrays.values(), first, *numbers, log_albedo, *out)
    for result, exact in zip([log_albedo, *out], expected, strict=True):
        np.testing.assert_allclose(result, exact, rtol=2e-4, atol=2e-5)


def test_rows_are_sorted_by_point_and_keep_their_order():
    point = np.array([2, 0, 2, 5, 0, 2], np.int32)
    order, ends = rows_by_point(point, 6)
    assert order.tolist() == [1, 4, 0, 2, 5, 3]
    assert ends.tolist() == [0, 2, 2, 5, 5, 5, 6]
