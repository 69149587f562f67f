"""Photos averaged on the texture."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from dante_w.texture import photo_average as average
from dante_w.texture.photo_average import PhotoAverage


def grid(spacing: float, angle: float, size: int) -> np.ndarray:
    """Hits of a photo's pixels, `spacing` texels apart, that cover a size x size texture: uv."""
    n = int(2 * size / spacing) + 4
    a, b = np.meshgrid(np.arange(-n, n), np.arange(-n, n))
    c, s = np.cos(angle) * spacing, np.sin(angle) * spacing
    uv = np.stack([a * c - b * s + 0.3, a * s + b * c + 0.1], -1).reshape(-1, 2) / size + 0.5
    return uv[((uv >= 0) & (uv <= 1)).all(1)]


def plane(uv: np.ndarray) -> np.ndarray:
    return np.stack([0.2 + 0.5 * uv[..., 0], 0.8 - 0.5 * uv[..., 1], 0.3 + 0 * uv[..., 0]], -1)


def centres(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height), -1)


def test_doctest() -> None:
    assert doctest.testmod(average).failed == 0


@pytest.mark.parametrize("size", [(16, 16), (13, 7), (1, 1)])
def test_samples_at_texel_centres_come_back(size: tuple[int, int]) -> None:
    uv = centres(*size)
    colour = np.random.default_rng(0).random((*uv.shape[:2], 3)).astype(np.float32)
    mean = PhotoAverage(*size)
    mean.add(uv, colour, 1.0, 1.0)
    np.testing.assert_allclose(mean.resolve(), colour, atol=1e-5)


def test_weights_and_linear_mean() -> None:
    mean = PhotoAverage(1, 1)
    mean.add([[0.5, 0.5], [0.5, 0.5]], [[0.1] * 3, [0.9] * 3], np.array([3.0, 1.0]), 1.0)
    np.testing.assert_allclose(mean.resolve()[0, 0], 0.3, atol=1e-6)


@pytest.mark.parametrize("spacing", [0.4, 1.0, 1.5, 3.7, 11.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4])
def test_coarse_photos_leave_no_holes_and_stay_sharp(spacing: float, angle: float) -> None:
    size = 128
    uv = grid(spacing, angle, size)
    mean = PhotoAverage(size, size)
    mean.add(uv, plane(uv), 1.0, spacing)
    edge = int(2 * spacing) + 2
    error = abs(mean.resolve() - plane(centres(size, size)))[edge : size - edge, edge : size - edge]
    assert error.max() < 0.5 * max(spacing, 1.0) / size  # the plane's slope times one pixel


def test_finer_wins() -> None:
    mean = PhotoAverage(64, 64)
    uv = centres(64, 64).reshape(-1, 2)
    mean.add(uv, np.full((len(uv), 3), 0.1), 100.0, 16.0)
    left = uv[uv[:, 0] < 0.5]
    mean.add(left, np.full((len(left), 3), 0.7), 1.0, 0.8)
    texture = mean.resolve()
    np.testing.assert_allclose(texture[:, :32], 0.7, atol=1e-5)
    np.testing.assert_allclose(texture[:, 48:], 0.1, atol=1e-5)  # beyond a cell of the coarse photo
    assert (np.diff(texture[:, 31:], axis=1) <= 1e-6).all()


def test_chunks_add_up_and_bad_samples_are_ignored() -> None:
    rng = np.random.default_rng(5)
    uv, colour, weight, size = (
        rng.random((500, 2)),
        rng.random((500, 3)),
        rng.random(500),
        rng.uniform(0.1, 9, 500),
    )
    one, two = PhotoAverage(33, 20), PhotoAverage(33, 20)
    one.add(uv, colour, weight, size)
    for part in np.array_split(np.arange(500), 7):
        two.add(uv[part], colour[part], weight[part], size[part])
    bad = np.array([[np.nan, 0.5], [1.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, np.inf]])
    two.add(
        bad, [[9.0] * 3] * 2 + [[np.nan] * 3] + [[9.0] * 3] * 3, [1, 1, 1, 0, 1, 1], [1, 1, 1, 1, np.nan, 1]
    )
    np.testing.assert_array_equal(one.resolve(), two.resolve())


def test_empty_is_grey_and_everything_is_filled() -> None:
    assert (PhotoAverage(5, 3).resolve() == 0.5).all()
    mean = PhotoAverage(40, 9)
    mean.add([[1.0, 0.0]], [[0.2, 0.3, 0.4]], 1.0, 0.1)
    np.testing.assert_allclose(mean.resolve(), np.broadcast_to([0.2, 0.3, 0.4], (9, 40, 3)), atol=1e-6)
    with pytest.raises(ValueError, match="texture"):
        PhotoAverage(0, 4)
