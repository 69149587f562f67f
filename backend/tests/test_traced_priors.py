"""What several views' priors tell of the points: gains of the views taken out, holes survived."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dante_w.core.color import srgb_from_linear_array
from dante_w.rays.ray_cache import RayCache, Surface
from dante_w.traced.albedo_prior import fuse_priors
from dante_w.traced.shading_points import USUAL_SHADING, ShadingPoints, gather

SIDE = USUAL_SHADING.side

VIEWS, CELLS = 6, 24  # cells along either side of the part of the texture that is seen
#: What a point's priors weigh beside photos that see it, and the views from which on they weigh as much: as documented.
TRUST, ENOUGH_VIEWS = 0.05, 4
GAINS = np.exp(np.random.default_rng(1).normal(0.0, 0.3, (VIEWS, 3)))


def colours() -> np.ndarray:
    """(CELLS * CELLS, 3) linear albedo of the cells."""
    return np.random.default_rng(2).uniform(0.1, 0.4, (CELLS * CELLS, 3))


def cache_of(
    priors: list[np.ndarray | None], cells: list[np.ndarray], trust: np.ndarray | None = None
) -> RayCache:
    """One pixel in the middle of each cell that a view sees, and its linear prior there; None: a view without one. All views
    are to be trusted as far as `trust` (N,) says."""
    triangle = np.array([[(0, 0), (1, 0), (0, 1)]], np.float64)
    surface = Surface(
        torch.from_numpy(triangle).float(),
        torch.from_numpy(np.pad(triangle, [(0, 0), (0, 0), (0, 1)])).float(),
    )
    cell = np.concatenate(cells)
    uv = (np.stack([cell % CELLS, cell // CELLS], axis=1) + 0.5) / SIDE
    prior = [
        np.full((len(own), 4), np.nan)
        if linear is None
        else np.column_stack([srgb_from_linear_array(linear), np.ones(len(own)) if trust is None else trust])
        for linear, own in zip(priors, cells, strict=True)
    ]
    return RayCache(
        surface,
        np.concatenate([[0], np.cumsum([len(own) for own in cells])]),
        np.zeros(len(cell), np.int32),
        np.rint(uv * 65535).astype(np.uint16),
        np.full((len(cell), 3), 0.5, np.float16),
        np.concatenate(prior).astype(np.float16),
    )


def points_of(cache: RayCache) -> ShadingPoints:
    return gather(cache, np.full((len(cache.starts) - 1, 3), 2.0))[0]


EVERYTHING = [np.arange(CELLS * CELLS)] * VIEWS


def test_each_views_gain_is_taken_out():
    cache = cache_of([colours() * gain for gain in GAINS], EVERYTHING)
    found = fuse_priors(cache, points_of(cache))
    assert found is not None
    off = found.log_albedo - np.log(colours())
    np.testing.assert_allclose(off.mean(axis=0), np.log(GAINS).mean(axis=0), atol=0.01)
    np.testing.assert_allclose(found.weight, TRUST)


def test_what_few_views_see_has_no_seams():
    """Each view sees a band of rows, half of it in common with the next; without gains there is a step at each."""
    row = np.arange(CELLS * CELLS) // CELLS
    cells = [np.flatnonzero((row >= 3 * view) & (row < 3 * view + 9)) for view in range(VIEWS)]
    cache = cache_of([colours()[own] * gain for own, gain in zip(cells, GAINS, strict=True)], cells)
    points = points_of(cache)
    found = fuse_priors(cache, points)
    assert found is not None and len(points) == CELLS * CELLS
    off = found.log_albedo - np.log(colours())
    plain = sum(
        np.isin(np.arange(CELLS * CELLS), own)[:, None] * np.log(gain)
        for own, gain in zip(cells, GAINS, strict=True)
    )
    views = np.sum([np.bincount(own, minlength=CELLS * CELLS) for own in cells], axis=0)
    assert off.std(axis=0).mean() < 0.8 * (plain / views[:, None]).std(axis=0).mean()
    np.testing.assert_allclose(found.weight, TRUST * np.minimum(views, ENOUGH_VIEWS) / ENOUGH_VIEWS)


def test_the_order_of_views_does_not_matter():
    random = np.random.default_rng(3)
    cells = [np.flatnonzero(random.random(CELLS * CELLS) < 0.5) for _ in range(VIEWS)]
    priors = [
        colours()[own] * gain * random.uniform(0.9, 1.1, (len(own), 3))
        for own, gain in zip(cells, GAINS, strict=True)
    ]
    ahead = cache_of(priors, cells)
    back = cache_of(priors[::-1], cells[::-1])
    a, b = (fuse_priors(cache, points_of(cache)) for cache in (ahead, back))
    assert a is not None and b is not None
    np.testing.assert_allclose(a.log_albedo, b.log_albedo, atol=1e-5)
    np.testing.assert_array_equal(a.weight, b.weight)


@pytest.mark.parametrize("missing", [0, 3, VIEWS - 1])
def test_a_view_without_a_prior_is_as_if_it_were_not_there(missing):
    priors = [colours() * gain for gain in GAINS]
    with_hole = cache_of(
        [None if view == missing else prior for view, prior in enumerate(priors)], EVERYTHING
    )
    without = cache_of(priors[:missing] + priors[missing + 1 :], EVERYTHING[1:])
    a, b = (fuse_priors(cache, points_of(cache)) for cache in (with_hole, without))
    assert a is not None and b is not None
    np.testing.assert_allclose(a.log_albedo, b.log_albedo, atol=1e-6)
    np.testing.assert_array_equal(a.weight, b.weight)


def test_pixels_that_are_not_a_number_and_points_without_a_prior():
    prior = colours()
    prior[:5, 1] = np.nan
    cache = cache_of([prior, None], EVERYTHING[:2])
    found = fuse_priors(cache, points_of(cache), weight=2.0)
    assert found is not None and np.isfinite(found.log_albedo).all()
    np.testing.assert_allclose(found.weight[:5], 0.0)
    np.testing.assert_allclose(found.weight[5:], 2.0 * TRUST / ENOUGH_VIEWS)
    np.testing.assert_allclose(found.log_albedo[5:], np.log(colours()[5:]), atol=0.01)


def test_what_is_not_to_be_trusted_counts_less():
    """Half of the cells are wrong in two of three views, and these say so."""
    wrong = np.arange(CELLS * CELLS) % 2 == 0
    odd = np.where(wrong[:, None], 3.0 * colours(), colours())
    unsure = np.where(wrong, 0.01, 1.0)
    views = [cache_of([odd], EVERYTHING[:1], unsure), cache_of([colours()], EVERYTHING[:1])]
    order = views[0], views[1], views[0]
    cache = RayCache(
        views[0].surface,
        CELLS * CELLS * np.arange(4),
        *(
            np.concatenate([getattr(view, name) for view in order])
            for name in ("face", "bary", "colour", "prior")
        ),
    )
    found = fuse_priors(cache, points_of(cache))
    assert found is not None
    np.testing.assert_allclose(found.log_albedo, np.log(colours()), atol=0.1)  # log(7 / 3) = 0.85 otherwise
    np.testing.assert_allclose(found.weight[wrong], 1.02 * TRUST / ENOUGH_VIEWS, rtol=1e-3)
    np.testing.assert_allclose(found.weight[~wrong], 3.0 * TRUST / ENOUGH_VIEWS, rtol=1e-3)


def test_no_priors_tell_nothing():
    cache = cache_of([None, None], EVERYTHING[:2])
    assert fuse_priors(cache, points_of(cache)) is None
    cache = RayCache(cache.surface, cache.starts, cache.face, cache.bary, cache.colour, None)
    assert fuse_priors(cache, points_of(cache)) is None
