"""Baking: what each texel gets, seams, filling, memory and bands."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.texture.bake import BakeSettings, bake
from dante_w.texture.coverage import Coverage, empty_coverage, mark
from dante_w.texture.rasterise import rasterise
from hypothesis import given, settings
from hypothesis import strategies as st


def square(u0: float, v0: float, u1: float, v1: float) -> np.ndarray:
    a, b, c, d = (u0, v0), (u1, v0), (u1, v1), (u0, v1)
    return np.array([[a, b, c], [a, c, d]], float)


def all_seen(width: int, height: int) -> Coverage:
    coverage = empty_coverage(width, height)
    coverage.levels[-1][:] = 128
    return coverage


def run(texels, uvs, coverage, dtype=np.float32, progress=lambda _: None, band_rows=None, **settings):  # type: ignore[no-untyped-def]
    out = np.zeros((coverage.height, coverage.width, 3), dtype)
    marks = np.full(out.shape[:2], 77, np.uint8)
    if band_rows is not None:
        settings["band_texels"] = band_rows * coverage.width
    fraction = bake(texels, uvs, coverage, out, marks, progress, BakeSettings(**{"gutter": 4, **settings}))
    return out, marks, fraction


def ramp(uv: np.ndarray) -> np.ndarray:
    return np.stack([uv[:, 0], uv[:, 1], 0.5 * uv[:, 0] * uv[:, 1]], axis=1).astype(np.float32)


def bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    height, width = texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]

    def at(j: np.ndarray, i: np.ndarray) -> np.ndarray:
        return texture[j.clip(0, height - 1), i.clip(0, width - 1)]

    return (at(j, i) * (1 - fx) + at(j, i + 1) * fx) * (1 - fy) + (
        at(j + 1, i) * (1 - fx) + at(j + 1, i + 1) * fx
    ) * fy


def inside(triangle: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    weight = rng.dirichlet((0.4, 0.4, 0.4), n)  # many near edges and corners
    return weight @ triangle


def test_texel_centres_and_marks() -> None:
    asked = []

    def texels(uv: np.ndarray) -> np.ndarray:
        asked.append(uv)
        return ramp(uv)

    out, marks, fraction = run(texels, square(0, 0, 1, 1), all_seen(7, 5))
    u, v = np.meshgrid((np.arange(7) + 0.5) / 7, 1 - (np.arange(5) + 0.5) / 5)
    np.testing.assert_allclose(out, ramp(np.stack([u, v], -1).reshape(-1, 2)).reshape(5, 7, 3), atol=1e-7)
    assert (marks == 255).all() and fraction == 1.0
    assert sum(map(len, asked)) == 35


@pytest.mark.parametrize("size", [(64, 64), (96, 50), (37, 61)])
@pytest.mark.parametrize("gutter", [0, 1, 4])
def test_seams_carry_no_foreign_colour(size: tuple[int, int], gutter: int) -> None:
    """Two charts a few texels apart, and a sliver that holds no texel centre at all."""
    w, h = size
    red, blue = np.float32([0.9, 0.1, 0.1]), np.float32([0.1, 0.2, 0.9])
    left = np.array([[[0.05, 0.05], [0.45, 0.1], [0.2, 0.9]]])
    gap = np.array([4.0 / w, 0.0])
    right = np.array([[left[0, 1] + gap, [0.95, 0.5], left[0, 2] + gap]])
    sliver = np.array([[[0.9, 0.05], [0.9 + 0.2 / w, 0.05], [0.9, 0.3]]])

    def texels(uv: np.ndarray) -> np.ndarray:
        blue_side = uv[:, 0] - 0.45 - (uv[:, 1] - 0.1) * (0.2 - 0.45) / 0.8 > 2.0 / w
        return np.where(blue_side[:, None], blue, red)

    out, _, fraction = run(texels, np.concatenate([left, right, sliver]), all_seen(w, h), gutter=gutter)
    rng = np.random.default_rng(0)
    assert fraction == 1.0
    np.testing.assert_allclose(
        bilinear(out, inside(left[0], 4000, rng)), np.broadcast_to(red, (4000, 3)), atol=1e-6
    )
    np.testing.assert_allclose(
        bilinear(out, inside(right[0], 4000, rng)), np.broadcast_to(blue, (4000, 3)), atol=1e-6
    )
    np.testing.assert_allclose(
        bilinear(out, inside(sliver[0], 900, rng)), np.broadcast_to(blue, (900, 3)), atol=1e-6
    )


def test_asks_only_near_what_photos_saw() -> None:
    coverage = empty_coverage(32, 32)
    mark(coverage, np.array([[0.25, 0.25], [0.75, 0.5]]), 2.0)
    asked = []

    def texels(uv: np.ndarray) -> np.ndarray:
        asked.append(uv)
        return ramp(uv)

    _, marks, fraction = run(texels, square(0.1, 0.1, 0.9, 0.9), coverage)
    uv = np.concatenate(asked)
    assert np.minimum(abs(uv - [0.25, 0.25]).max(1), abs(uv - [0.75, 0.5]).max(1)).max() < 2.13 * 2 / 32
    chart = rasterise(square(0.1, 0.1, 0.9, 0.9), 32, 32) >= 0
    assert ((marks > 0) == chart).all() and set(np.unique(marks)) == {0, 128, 255}
    assert fraction == (marks == 255).sum() / chart.sum() > 0


def test_gutter_is_the_nearest_texel() -> None:
    uvs = np.array([[[0.3, 0.35], [0.7, 0.3], [0.45, 0.75]]])
    out, marks, _ = run(ramp, uvs, all_seen(40, 40), gutter=5)
    border = out.copy()
    border_run, _, _ = run(ramp, uvs, all_seen(40, 40), gutter=0)
    known = np.argwhere((marks == 255) | (abs(border_run - _ramp_at_nearest(uvs, 40)).max(-1) < 1e-6))
    owned = np.argwhere(marks == 255)
    for j, i in np.argwhere(marks == 0):
        away = ((known - (j, i)) ** 2).sum(1)
        if 0 < away.min() < 36 and not (known == (j, i)).all(1).any():
            nearest = known[away == away.min()]
            assert (border[j, i] == border[nearest[:, 0], nearest[:, 1]]).all(1).any()
    assert len(owned) > 50


def _ramp_at_nearest(uvs: np.ndarray, size: int) -> np.ndarray:
    """The ramp at the point of the triangle nearest to each texel centre."""
    centre = np.stack(np.meshgrid((np.arange(size) + 0.5) / size, 1 - (np.arange(size) + 0.5) / size), -1)
    best = np.full((size, size), np.inf)
    point = np.zeros((size, size, 2))
    for a, b in zip(uvs[0], np.roll(uvs[0], -1, 0), strict=True):
        t = ((centre - a) @ (b - a) / ((b - a) @ (b - a))).clip(0, 1)[..., None]
        q = a + t * (b - a)
        away = np.linalg.norm(q - centre, axis=-1)
        point[away < best] = q[away < best]
        best = np.minimum(best, away)
    value = ramp(point.reshape(-1, 2)).reshape(size, size, 3)
    value[best * size > np.sqrt(2)] = np.nan
    return value


def test_whole_texture_is_filled_within_the_range_of_the_seen() -> None:
    coverage = empty_coverage(50, 70)
    mark(coverage, np.random.default_rng(1).uniform(0.3, 0.5, (40, 2)), 1.0)
    out, marks, fraction = run(lambda uv: 0.4 + 0.2 * ramp(uv), square(0.2, 0.2, 0.8, 0.8), coverage)
    assert 0 < fraction < 0.5
    low, high = out[marks == 255].min(0), out[marks == 255].max(0)
    assert (out >= low - 1e-6).all() and (out <= high + 1e-6).all()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 90), st.integers(1, 90), st.sampled_from(["u1", "u2", "f2", "f4"])
)
def test_bands_do_not_show(seed: int, width: int, height: int, dtype: str) -> None:
    rng = np.random.default_rng(seed)
    uvs = rng.uniform(0, 1, (4, 3, 2))
    coverage = empty_coverage(width, height)
    mark(coverage, rng.uniform(0, 1, (30, 2)), rng.uniform(0.1, 8, 30))
    whole = run(ramp, uvs, coverage, np.dtype(dtype), gutter=3, band_rows=height)
    for band_rows in (1, 7, 16):
        part = run(ramp, uvs, coverage, np.dtype(dtype), gutter=3, band_rows=band_rows)
        assert whole[2] == part[2]
        assert whole[0].tobytes() == part[0].tobytes() and whole[1].tobytes() == part[1].tobytes()


@pytest.mark.parametrize("size", [(40, 33), (64, 64), (5, 77)])
def test_bands_do_not_show_with_fine_levels(size: tuple[int, int]) -> None:
    """As for a texture far beyond 1024, and equal to keeping every level whole."""
    coverage = empty_coverage(*size)
    rng = np.random.default_rng(3)
    mark(coverage, rng.uniform(0, 1, (9, 2)), 1.0)
    whole = run(ramp, square(0, 0, 1, 1), coverage, gutter=0)[0]
    several = [
        run(ramp, square(0, 0, 1, 1), coverage, gutter=0, band_rows=n, largest_kept=4)[0]
        for n in (1, 5, 8, 100)
    ]
    assert all(np.array_equal(several[0], other) for other in several[1:])
    np.testing.assert_allclose(several[0], whole, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16, np.float32])
def test_nothing_seen_and_nothing_there(dtype: type) -> None:
    out, marks, fraction = run(ramp, square(0, 0, 1, 1), empty_coverage(1, 1), dtype=dtype)
    assert fraction == 0.0 and marks[0, 0] == 128 and len(np.unique(out)) == 1
    out, marks, fraction = run(ramp, np.zeros((0, 3, 2)), all_seen(9, 4), dtype=dtype)
    assert fraction == 0.0 and not marks.any() and len(np.unique(out)) == 1 and out.min() > 0


def test_not_finite_colours_count_as_unseen() -> None:
    def texels(uv: np.ndarray) -> np.ndarray:
        return np.where(uv[:, :1] < 0.5, np.nan, 0.25 + 0 * ramp(uv))

    out, marks, fraction = run(texels, square(0, 0, 1, 1), all_seen(16, 16))
    assert fraction == 0.5 and (marks[:, :8] == 128).all() and (marks[:, 8:] == 255).all()
    np.testing.assert_allclose(out, 0.25, atol=1e-6)


def test_progress_rises_to_one_and_may_cancel() -> None:
    steps: list[float] = []
    run(ramp, square(0, 0, 1, 1), all_seen(64, 64), progress=steps.append, band_rows=16)
    assert steps == sorted(steps) and steps[-1] == 1.0 and len(steps) > 8

    def cancel(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(ramp, square(0, 0, 1, 1), all_seen(64, 64), progress=cancel)


def test_wrong_arrays_are_refused() -> None:
    coverage = all_seen(8, 8)
    good, marks = np.zeros((8, 8, 3), np.float32), np.zeros((8, 8), np.uint8)
    for out, cov in (
        (good[:4], marks),
        (good, marks[:4]),
        (good.astype(np.int32), marks),
        (good, good[..., 0]),
    ):
        with pytest.raises(ValueError, match="texture"):
            bake(ramp, square(0, 0, 1, 1), coverage, out, cov)
