"""The rasteriser against exact fractions and closed forms, and the check of UVs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.texture import rasterise as uvmap
from dante_w.texture.check_uvs import check_uvs, overlap_fraction
from dante_w.texture.rasterise import bin_faces, rasterise, rasterise_bins, rasterise_border
from hypothesis import given, settings
from hypothesis import strategies as st

sizes = st.tuples(st.integers(1, 40), st.integers(1, 40))


def fan(points: np.ndarray, hub: np.ndarray) -> np.ndarray:
    return np.stack([np.broadcast_to(hub, points.shape), points, np.roll(points, -1, 0)], axis=1)


def grid(n: int, jitter: float, rng: np.random.Generator) -> np.ndarray:
    """The unit square in 2 n^2 triangles, inner corners moved by up to `jitter` cells."""
    u, v = np.meshgrid(np.arange(n + 1) / n, np.arange(n + 1) / n)
    corner = np.stack([u, v], -1)
    corner[1:-1, 1:-1] += rng.uniform(-jitter, jitter, (n - 1, n - 1, 2)) / n
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 2)
    flip = rng.random(len(faces)) < 0.5
    faces[flip] = faces[flip, ::-1]
    return faces


def holds(triangle: np.ndarray, width: int, height: int, i: int, j: int) -> int:
    """-1, 0, 1: texel centre (i, j) is outside, on the edge of, inside the snapped triangle; exact."""
    snapped = np.rint((triangle * [1, -1] + [0, 1]) * [width, height] * 16384).astype(int).tolist()
    x, y = Fraction(2 * i + 1, 2) * 16384, Fraction(2 * j + 1, 2) * 16384
    sides = []
    for (ax, ay), (bx, by) in zip(snapped, snapped[1:] + snapped[:1], strict=True):
        sides.append((bx - ax) * (y - ay) - (by - ay) * (x - ax))
    if all(s > 0 for s in sides) or all(s < 0 for s in sides):
        return 1
    return 0 if all(s >= 0 for s in sides) or all(s <= 0 for s in sides) else -1


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**9), st.tuples(st.integers(1, 12), st.integers(1, 12)), st.booleans())
def test_against_exact_fractions(seed: int, size: tuple[int, int], on_lattice: bool) -> None:
    rng = np.random.default_rng(seed)
    width, height = size
    uvs = rng.uniform(-0.1, 1.1, (1, 3, 2))
    if on_lattice:  # corners on texel centres and corners: many ties
        uvs = np.rint(uvs * [2 * width, 2 * height]) / [2 * width, 2 * height]
    owner = rasterise(uvs, width, height)
    assert owner.shape == (height, width) and owner.dtype == np.int32
    sides = np.array([[holds(uvs[0], width, height, i, j) for i in range(width)] for j in range(height)])
    area = np.cross(*(np.append(uvs[0, k] - uvs[0, 0], 0) for k in (1, 2)))[2]
    if abs(area) > 1e-9:
        assert (owner[sides > 0] == 0).all()
    assert (owner[sides < 0] == -1).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), sizes, st.integers(1, 6), st.sampled_from([0.0, 0.3]))
def test_every_texel_of_a_partition_has_one_face(
    seed: int, size: tuple[int, int], n: int, jitter: float
) -> None:
    uvs = grid(n, jitter, np.random.default_rng(seed))
    assert (rasterise(uvs, *size) >= 0).all()
    count = sum((rasterise(face[None], *size) == 0).astype(int) for face in uvs)
    assert (count == 1).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), sizes)
def test_fan_around_a_texel_centre(seed: int, size: tuple[int, int]) -> None:
    width, height = size
    rng = np.random.default_rng(seed)
    hub = np.array([(rng.integers(width) + 0.5) / width, (rng.integers(height) + 0.5) / height])
    angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
    if np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() > 3:
        return
    uvs = fan(hub + 0.4 * np.stack([np.cos(angle), np.sin(angle)], 1), hub)
    count = sum((rasterise(face[None], width, height) == 0).astype(int) for face in uvs)
    assert count.max() == 1
    assert count[round((1 - hub[1]) * height - 0.5), round(hub[0] * width - 0.5)] == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**9), st.integers(1, 50), st.integers(1, 200))
def test_bands_and_face_order_do_not_matter(seed: int, width: int, height: int) -> None:
    rng = np.random.default_rng(seed)
    uvs = grid(4, 0.3, rng) * 0.8 + 0.07
    whole = rasterise(uvs, width, height)
    bins = bin_faces(uvs, width, height)
    cuts = np.unique(np.append(rng.integers(0, height + 1, 4), [0, height]))
    bands = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
    assert np.array_equal(np.concatenate([rasterise_bins(bins, rows) for rows in bands]), whole)
    order = rng.permutation(len(uvs))
    shuffled = rasterise(uvs[order], width, height)
    assert np.array_equal(np.where(shuffled < 0, -1, order[shuffled]), whole)
    parts = [rasterise_border(bins, (a, b), whole[a:b]) for a, b in bands]
    index, uv = rasterise_border(bins, (0, height), whole)
    assert np.array_equal(
        np.concatenate([p[0] + b[0] * width for p, b in zip(parts, bands, strict=True)]), index
    )
    np.testing.assert_allclose(np.concatenate([p[1] for p in parts]), uv, atol=1e-12)


def test_closed_forms() -> None:
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    owner = rasterise(square, 4, 4)
    below = np.arange(4)[:, None] > 3 - np.arange(4)  # v < u, row 0 at the top
    assert (owner[below] == 0).all() and (owner[~below & ~np.eye(4, dtype=bool)[::-1]] == 1).all()
    assert len(np.unique(owner[np.eye(4, dtype=bool)[::-1]])) == 1  # the diagonal goes to one of them
    assert rasterise(square, 1, 1).tolist() in ([[0]], [[1]])
    assert (rasterise(square[[0, 0, 1]], 8, 8) != 1).all()  # the lowest face wins where faces overlap
    assert rasterise(square, 4, 4, (2, 2)).shape == (0, 4)
    assert (rasterise(np.zeros((0, 3, 2)), 3, 5) == -1).all()
    big = rasterise(square, 16384, 3)
    assert (big >= 0).all()


def test_degenerate_and_unusable_triangles_cover_nothing() -> None:
    line = [[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]]
    point = [[0.5, 0.5]] * 3
    bad = [[np.nan, 0.1], [0.9, 0.1], [0.5, 0.9]]
    far = [[0.1, 0.1], [9e9, 0.1], [0.5, 0.9]]
    good = [[0.1, 0.1], [0.9, 0.1], [0.5, 0.9]]
    uvs = np.array([line, point, bad, far, good])
    assert set(np.unique(rasterise(uvs, 20, 20))) == {-1, 4}
    for size in ((0, 4), (4, 40000)):
        with pytest.raises(ValueError, match="texture"):
            rasterise(uvs, *size)
    with pytest.raises(ValueError, match="rows"):
        rasterise(uvs, 4, 4, (2, 5))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**9), sizes)
def test_border_reaches_every_texel_a_lookup_reads(seed: int, size: tuple[int, int]) -> None:
    width, height = size
    rng = np.random.default_rng(seed)
    uvs = rng.uniform(0, 1, (2, 3, 2))
    owner = rasterise(uvs, width, height)
    index, uv = rasterise_border(bin_faces(uvs, width, height), (0, height), owner)
    row, column = np.divmod(index, width)
    away = np.hypot(uv[:, 0] * width - column - 0.5, (1 - uv[:, 1]) * height - row - 0.5)
    assert (owner[row, column] < 0).all() and (away < 1.415).all()
    known = owner >= 0
    known[row, column] = True
    inside = rng.dirichlet((0.3, 0.3, 0.3), 500) @ uvs
    x, y = inside[..., 0].ravel() * width - 0.5, (1 - inside[..., 1].ravel()) * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    for b, a in ((0, 0), (0, 1), (1, 0), (1, 1)):
        share = abs(x - i - 1 + a) * abs(y - j - 1 + b)
        used = (share > 1e-3) & (i + a >= 0) & (i + a < width) & (j + b >= 0) & (j + b < height)
        assert known[(j + b)[used], (i + a)[used]].all()


def test_overlap() -> None:
    rng = np.random.default_rng(0)
    tiling = grid(6, 0.3, rng)
    assert overlap_fraction(tiling, margin=0.0) == 0.0
    assert overlap_fraction(np.concatenate([tiling, tiling])) > 0.9
    touching = np.concatenate([tiling * [0.5, 1], tiling * [0.5, 1] + [0.5 - 0.2 / 1024, 0]])
    assert overlap_fraction(touching) == 0.0
    half = np.concatenate([tiling * [0.5, 1], tiling * [0.5, 1] + [0.25, 0]])
    assert overlap_fraction(half) == pytest.approx(1 / 3, abs=0.02)
    fine = grid(600, 0.0, rng)  # faces smaller than a texel cannot hide an overlap
    assert overlap_fraction(fine) == 0.0 and overlap_fraction(np.concatenate([fine, fine])) > 0.1


def test_check_uvs() -> None:
    good = grid(3, 0.2, np.random.default_rng(0))
    check_uvs(good, "a.obj")
    check_uvs(good * (1 + 1e-5), "a.obj")
    broken = good.copy()
    broken[0, 0, 0] = np.nan
    for uvs, words in (
        (None, "no UVs"),
        (np.zeros((0, 3, 2)), "no UVs"),
        (broken, "not finite"),
        (good * 2, "UDIM"),
        (good - 0.1, "UDIM"),
        (good * [1, 0], "without any area"),
        (np.concatenate([good, good]), "overlap"),
    ):
        with pytest.raises(BadInput, match=words) as caught:
            check_uvs(uvs, Path("a.obj"))
        assert "a.obj" in str(caught.value) and "--unwrap" in str(caught.value)


@pytest.mark.skipif(os.name == "nt", reason="blocks the caches with files where folders are wanted")
@pytest.mark.parametrize("user_cache", [True, False])
def test_kernels_run_where_nothing_can_be_cached_beside_them(tmp_path: Path, user_cache: bool) -> None:
    package = Path(uvmap.__file__).parents[1]
    shutil.copytree(package, tmp_path / "dante_w", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "dante_w" / "texture" / "__pycache__").touch()
    cache = tmp_path / "cache" if user_cache else tmp_path / "dante_w" / "__init__.py" / "cache"
    code = "import numpy as np; from dante_w.texture.rasterise import rasterise; print(rasterise(np.eye(3)[None, :, :2], 4, 4).sum())"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"HOME": str(cache), "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert done.stdout.strip() == str(rasterise(np.eye(3)[None, :, :2], 4, 4).sum()), done.stderr
    if user_cache and sys.platform == "linux":
        assert list(cache.rglob("*.nbc"))
