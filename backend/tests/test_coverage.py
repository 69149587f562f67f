"""Which texels photos saw: no holes, bounded spill, fixed memory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from dante_w.texture.coverage import empty_coverage, mark, seen_texels
from hypothesis import given, settings
from hypothesis import strategies as st


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.2, 30.0),
    st.floats(0.0, 1.6),
    st.tuples(st.integers(20, 160), st.integers(20, 160)),
    st.integers(0, 10**9),
)
def test_no_holes_and_bounded_spill(footprint: float, angle: float, size: tuple[int, int], seed: int) -> None:
    """A photo's pixel grid, turned, scaled and shifted, over a rectangle of the texture."""
    width, height = size = tuple(min(n, int(60 * footprint) + 1) for n in size)
    rng = np.random.default_rng(seed)
    n = int(1.5 * max(size) / footprint) + 3
    a, b = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    shift = rng.uniform(0, 60, 2)
    x = (a * np.cos(angle) - b * np.sin(angle)).ravel() * footprint + width / 2 + shift[0] % footprint
    y = (a * np.sin(angle) + b * np.cos(angle)).ravel() * footprint + height / 2 + shift[1] % footprint
    low, high = np.sort(rng.uniform(0, 1, (2, 2)) * size, axis=0)
    keep = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    coverage = empty_coverage(width, height)
    mark(coverage, np.stack([x[keep] / width, 1 - y[keep] / height], 1), footprint)
    result = seen_texels(coverage)
    assert result.shape == (height, width) and result.dtype == bool
    i, j = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    inner = 4 * footprint + 2
    deep = (i > low[0] + inner) & (i < high[0] - inner) & (j > low[1] + inner) & (j < high[1] - inner)
    assert result[deep].all()
    spill = (
        max(2.1214 * footprint, 1.0) - 0.5 + 1e-6
    )  # from the sample to the centre of the texel at the far end
    outside = (i < low[0] - spill) | (i > high[0] + spill) | (j < low[1] - spill) | (j > high[1] + spill)
    assert not result[outside].any()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), st.integers(1, 70), st.integers(1, 70))
def test_rows_order_and_chunks_do_not_matter(seed: int, width: int, height: int) -> None:
    rng = np.random.default_rng(seed)
    uv, footprint = rng.random((25, 2)), 2 ** rng.uniform(-3, 5, 25)
    one, two = empty_coverage(width, height), empty_coverage(width, height)
    mark(one, uv, footprint)
    for k in rng.permutation(25):
        mark(two, uv[k : k + 1], footprint[k])
    assert all(np.array_equal(a, b) for a, b in zip(one.levels, two.levels, strict=True))
    whole = seen_texels(one)
    cuts = np.unique(np.append(rng.integers(0, height + 1, 5), [0, height])).tolist()
    parts = [seen_texels(one, rows) for rows in pairwise(cuts)]
    assert np.array_equal(np.concatenate(parts), whole)
    own = whole[((1 - uv[:, 1]) * height).astype(int), (uv[:, 0] * width).astype(int)]
    assert own.all()  # the texel that holds a sample is always seen


def test_closed_forms() -> None:
    coverage = empty_coverage(8, 8)
    mark(coverage, np.array([[0.3, 0.3]]), 0.1)
    assert np.argwhere(seen_texels(coverage)).tolist() == [[5, 2]]
    coverage = empty_coverage(8, 8)
    mark(coverage, np.array([[0.3, 0.3]]), 1.0)  # at (2.4, 5.6): the 2 x 2 nearest texels
    assert np.argwhere(seen_texels(coverage)).tolist() == [[5, 1], [5, 2], [6, 1], [6, 2]]
    coverage = empty_coverage(8, 8)
    mark(coverage, np.array([[0.5, 0.5]]), 2.8)  # cells of 2 texels: the middle
    assert seen_texels(coverage).sum() == 16 and seen_texels(coverage)[2:6, 2:6].all()
    mark(coverage, np.array([[0.5, 0.5]]), 1e30)
    assert seen_texels(coverage).all()


def test_corners_of_the_texture_and_samples_to_ignore() -> None:
    coverage = empty_coverage(9, 6)
    mark(coverage, np.array([[0, 0], [1, 0], [0, 1], [1, 1]], float), 0.0)
    assert np.argwhere(seen_texels(coverage)).tolist() == [[0, 0], [0, 8], [5, 0], [5, 8]]
    coverage = empty_coverage(9, 6)
    bad = np.array([[np.nan, 0.5], [0.5, np.inf], [-0.1, 0.5], [0.5, 1.1], [0.5, 0.5], [0.5, 0.5]])
    mark(coverage, bad, np.array([1, 1, 1, 1, np.nan, np.inf]))
    mark(coverage, np.zeros((0, 2)), 1.0)
    assert not seen_texels(coverage).any() and seen_texels(coverage, (3, 3)).shape == (0, 9)
    with pytest.raises(ValueError, match="texture"):
        empty_coverage(0, 3)
    with pytest.raises(ValueError, match="rows"):
        seen_texels(coverage, (0, 7))


def test_memory_depends_on_the_size_alone() -> None:
    assert sum(level.nbytes for level in empty_coverage(4096, 4096).levels) < 4096**2 / 6 + 100
    one = empty_coverage(1, 1)
    mark(one, np.array([[0.2, 0.9]]), 50.0)
    assert seen_texels(one).tolist() == [[True]]
