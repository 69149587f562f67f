"""Each weight against its closed form, and a texture that people in some photos do not tint."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.rays.depth_edges import EDGES, edge_distances
from dante_w.traced.pixel_weights import (
    PixelWeightSettings,
    clipped_weight,
    consensus,
    consensus_weight,
    dark_weight,
    edge_weight,
    medians,
)

#: The numbers that the weights are documented with, written down here again so that none is held against itself.
CLIPPED, HOPELESS, NOISY, NEAR_EDGE = 0.995, 1e-3, 0.01, 2
OUTLYING, BRIGHTER, AGREED, LEAST, FEWEST = 2.0, 2.0, 0.12, 0.25, 4
RANDOM = np.random.default_rng(4)


def test_clipped_pixels_count_only_where_nothing_else_tells():
    srgb = np.array([(0.5, 0.5, 0.5), (0.2, CLIPPED, 0.2), (1.0, 1.0, 1.0)])
    assert clipped_weight(srgb, np.ones(3, bool)).tolist() == [1.0, 0.0, 0.0]
    assert clipped_weight(srgb, np.zeros(3, bool)).tolist() == [1.0, HOPELESS, HOPELESS]


def test_dark_is_signal_over_signal_and_noise():
    np.testing.assert_allclose(dark_weight(np.array([0.0, NOISY, 3.0 * NOISY])), [0.0, 0.5, 0.9])
    assert dark_weight(np.array([-0.1]))[0] == 0.0 and dark_weight(np.array([1.0]))[0] > 0.999


def test_pixels_away_from_edges_count_fully_and_none_is_lost():
    weight = edge_weight(np.arange(EDGES.reach + 1, dtype=np.uint8))
    assert weight[0] > 0.0 and (np.diff(weight[: NEAR_EDGE + 1]) > 0.0).all()
    np.testing.assert_array_equal(weight[NEAR_EDGE:], 1.0)


def test_edges_are_where_depth_jumps_and_not_at_the_photos_border():
    depth = np.full((21, 30), 2.0)
    depth[:, 20:] = 3.0
    depth[10, 5] = 0.0
    found = edge_distances(depth, 100.0)
    row, column = np.indices(depth.shape)
    # beside an edge: the two columns at the step, the hole and its four neighbours
    seeds = [(r, c) for r in range(21) for c in (19, 20)] + [(10, 5), (9, 5), (11, 5), (10, 4), (10, 6)]
    brute = np.min([np.maximum(abs(row - r), abs(column - c)) for r, c in seeds], axis=0)
    np.testing.assert_array_equal(found, np.minimum(brute, EDGES.reach))


def test_a_slope_is_no_edge_until_it_is_too_steep_to_be_seen():
    focal, across = 100.0, np.arange(12)
    gentle = np.tile(2.0 * (1.0 + 0.9 * EDGES.steepness / focal) ** across, (3, 1))
    steep = np.tile(2.0 * (1.0 + 1.1 * EDGES.steepness / focal) ** across, (3, 1))
    assert (edge_distances(gentle, focal) == EDGES.reach).all()
    assert (edge_distances(steep, focal) == 0).all()


def test_medians_are_weighted():
    group = RANDOM.integers(0, 5, 400)
    values = RANDOM.normal(size=400)
    weight = RANDOM.integers(0, 4, 400).astype(float)
    found = medians(values, weight, group)
    for g in range(5):
        repeated = np.sort(np.repeat(values[group == g], weight[group == g].astype(int)))
        assert found[g] == repeated[(len(repeated) - 1) // 2]
    assert medians(np.array([3.0]), np.zeros(1), np.array([1])).tolist() == [0.0, 0.0]


def outlier(
    rows: np.ndarray, weight: np.ndarray, noise: np.ndarray, point: np.ndarray, light: np.ndarray
) -> np.ndarray:
    """The trust in photos that are themselves all that there are."""
    return consensus_weight(rows, noise, point, consensus(rows, weight, point, light))


def one_point(values: list[float], light: list[int] | None = None, weight: float = 1.0) -> np.ndarray:
    """The trust in what photos say of one point, alike in all channels."""
    count = len(values)
    lights = np.arange(count) if light is None else np.array(light)
    rows = np.repeat(np.array(values)[:, None], 3, axis=1)
    return outlier(rows, np.full(count, weight), np.zeros(count), np.zeros(count, int), lights)


def test_who_agrees_is_trusted_and_who_does_not_is_out():
    np.testing.assert_array_equal(one_point([0.3] * 6), 1.0)
    trust = one_point([0.3] * 6 + [1.5, -1.0])
    np.testing.assert_array_equal(trust, [1.0] * 6 + [0.0, 0.0])


def test_doubt_grows_with_distance_and_faster_above():
    off = 0.8 * OUTLYING * AGREED / BRIGHTER
    above, below = one_point([0.0] * 9 + [off])[-1], one_point([0.0] * 9 + [-off])[-1]
    assert above == pytest.approx((1.0 + 0.8**2) ** -2)
    assert below == pytest.approx((1.0 + (0.8 / BRIGHTER) ** 2) ** -2)
    assert LEAST < above < below < 1.0


def test_where_photos_differ_anyhow_and_in_noise_more_is_forgiven():
    off = -2.0 * OUTLYING * AGREED
    assert one_point([0.0] * 9 + [off])[-1] == 0.0
    assert one_point([-0.4, 0.4, -0.3, 0.3, 0.0, 0.35, -0.35, off])[-1] > 0.0
    noisy = np.zeros(10)
    noisy[-1] = 1.0
    rows = np.zeros((10, 3))
    rows[-1] = off
    assert outlier(rows, np.ones(10), noisy, np.zeros(10, int), np.arange(10))[-1] > 0.5


def test_few_photos_make_no_consensus():
    assert one_point([0.0, 0.0, 5.0][: FEWEST - 1]).tolist() == [1.0] * (FEWEST - 1)


def test_photos_of_one_light_do_not_outvote_the_others():
    trust = one_point([1.0] * 9 + [0.0] * 8, [0] * 9 + [1] * 4 + [2] * 4)
    assert (trust[:9] == 0.0).all() and (trust[9:] > 0.5).all()
    alone = one_point([1.0] * 9 + [0.0] * 8, [0] * 17)
    assert (alone[:9] > 0.5).all()


def test_order_does_not_matter_and_broken_numbers_stay_out():
    count = 500
    rows = RANDOM.normal(0.0, 0.4, (count, 3))
    rows[3], rows[40, 1], rows[70] = np.nan, np.inf, -np.inf
    weight, noise = RANDOM.uniform(0.0, 1.0, count), RANDOM.uniform(0.0, 0.2, count)
    weight[RANDOM.random(count) < 0.1] = 0.0
    point, light = RANDOM.integers(0, 40, count), RANDOM.integers(0, 3, count)
    trust = outlier(rows, weight, noise, point, light)
    assert np.isfinite(trust).all() and (trust >= 0.0).all() and (trust <= 1.0).all()
    assert trust[3] == trust[40] == trust[70] == 0.0 and 0.0 < trust.mean() < 1.0
    order = RANDOM.permutation(count)
    again = outlier(rows[order], weight[order], noise[order], point[order], light[order])
    np.testing.assert_allclose(again, trust[order], rtol=1e-12)
    empty = np.zeros(0, int)
    assert len(outlier(np.zeros((0, 3)), np.zeros(0), np.zeros(0), empty, empty)) == 0
    assert np.isfinite(one_point([0.0] * 5, weight=0.0)).all()


def test_each_weight_can_be_left_out_by_its_setting():
    nothing = PixelWeightSettings(clipped_from=np.inf, noise=0.0, near_edge=0, outlier=np.inf)
    rows = np.array([[0.0] * 3] * 6 + [[3.0] * 3, [np.nan] * 3])
    point, count = np.zeros(len(rows), int), len(rows)
    expected = consensus(rows, np.ones(count), point, np.arange(count), nothing)
    assert (consensus_weight(rows, np.zeros(count), point, expected, nothing) == 1.0).all()
    assert (clipped_weight(np.ones((3, 3)), np.ones(3, bool), nothing) == 1.0).all()
    assert (dark_weight(np.array([0.0, 1e-3, 1.0]), nothing) == 1.0).all()
    assert (edge_weight(np.arange(4), nothing) == 1.0).all()
