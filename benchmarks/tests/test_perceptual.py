"""SSIM, LPIPS and FLIP."""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from collections.abc import Callable

import numpy as np
import pytest
from measure import perceptual
from measure.perceptual import ArrayUnpickler, flip, lpips, ssim

Metric = Callable[[np.ndarray, np.ndarray, np.ndarray], float]
ALL = pytest.mark.parametrize("metric", [ssim, lpips, flip])
WHOLE = np.ones((96, 112), bool)


def waves(phase: float) -> np.ndarray:
    """(96, 112, 3) sRGB: coloured waves with an edge through them."""
    y, x = np.mgrid[0:96, 0:112] / 96.0
    ramps = [np.sin(9.0 * x + 23.0 * y * y + phase + shift) for shift in (0.0, 0.9, 2.1)]
    picture = 0.5 + 0.35 * np.stack(ramps, axis=-1)
    picture[x + 0.3 * y > 0.8] *= 0.6
    return picture


def disc() -> np.ndarray:
    y, x = np.mgrid[0:96, 0:112]
    return (y - 50) ** 2 + (x - 60) ** 2 < 30**2


def distance(metric: Metric, picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """The metric, turned so that less is better."""
    value = metric(picture, truth, mask)
    return 1.0 - value if metric is ssim else value


@ALL
def test_equal_pictures_have_no_distance(metric: Metric) -> None:
    assert distance(metric, waves(0.3), waves(0.3), WHOLE) == pytest.approx(0.0, abs=1e-6)
    assert distance(metric, waves(0.3), waves(0.3), disc()) == pytest.approx(0.0, abs=1e-6)


@ALL
def test_outside_the_mask_nothing_counts(metric: Metric) -> None:
    mask, truth = disc(), waves(0.0)
    picture = waves(0.2)
    elsewhere = np.where(mask[..., None], picture, 0.77)
    inside = np.where(mask[..., None], 0.77, picture)
    assert metric(elsewhere, truth, mask) == metric(picture, truth, mask)
    assert abs(metric(inside, truth, mask) - metric(picture, truth, mask)) > 0.05


@ALL
def test_more_noise_is_worse(metric: Metric) -> None:
    truth, noise = waves(0.0), np.random.default_rng(7).standard_normal((96, 112, 3))
    for mask in (WHOLE, disc()):
        values = [distance(metric, truth + sigma * noise, truth, mask) for sigma in (0.01, 0.03, 0.09)]
        assert 0.0 < values[0] < values[1] < values[2]


@ALL
def test_the_mean_is_over_the_mask(metric: Metric) -> None:
    """An error in half of the picture weighs less the more of the good half is in the mask."""
    truth = waves(0.0)
    picture = truth.copy()
    picture[:, 56:] = waves(1.0)[:, 56:]
    bad, good = np.zeros((2, 96, 112), bool)
    bad[8:88, 60:108], good[8:88, 4:52] = True, True
    both = distance(metric, picture, truth, bad | good)
    assert distance(metric, picture, truth, good) < 0.1 * both
    assert distance(metric, picture, truth, bad) == pytest.approx(2.0 * both, rel=0.1)


@pytest.mark.parametrize("metric", [ssim, flip])
def test_the_crop_changes_nothing(metric: Metric, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small mask in a large picture: the same number as without the cut."""
    rows, columns = slice(140, 180), slice(150, 170)
    mask = np.zeros((320, 320), bool)
    mask[rows, columns] = True
    picture, truth = np.random.default_rng(3).random((2, 320, 320, 3))
    cut = metric(picture, truth, mask)
    assert perceptual.cropped(picture, truth, mask)[2].size < mask.size
    monkeypatch.setattr(perceptual, "MARGIN", 1000)
    assert metric(picture, truth, mask) == pytest.approx(cut, abs=1e-6)


def test_ssim_of_flat_pictures() -> None:
    """Without texture SSIM is (2ab + C) / (a^2 + b^2 + C), C = 0.01^2."""
    a, b = np.full((2, 64, 64, 3), [[[[0.4]]], [[[0.6]]]])
    expected = (2 * 0.4 * 0.6 + 1e-4) / (0.4**2 + 0.6**2 + 1e-4)
    assert ssim(a, b, np.ones((64, 64), bool)) == pytest.approx(expected, abs=1e-5)


def test_flip_of_pure_green_and_blue() -> None:
    """By FLIP's definition the largest difference of colours, 1."""
    green, blue = np.zeros((2, 96, 96, 3))
    green[..., 1], blue[..., 2] = 1.0, 1.0
    assert flip(green, blue, np.ones((96, 96), bool)) == pytest.approx(1.0, abs=1e-3)


def test_lpips_keeps_its_value() -> None:
    """Taken from this implementation once it had given the published distances of PerceptualSimilarity's example
    pair (AlexNet 0.1: ex_p0 0.722, ex_p1 0.138; it gave 0.72188 and 0.13757)."""
    assert lpips(waves(2.0), waves(0.0), WHOLE) == pytest.approx(0.17430, abs=2e-4)


def test_pickle_may_hold_arrays() -> None:
    tree = {"kernel": np.arange(6.0, dtype=np.float32).reshape(2, 3)}
    back = ArrayUnpickler(io.BytesIO(pickle.dumps(tree, protocol=4))).load()
    assert np.array_equal(back["kernel"], tree["kernel"])


@pytest.mark.parametrize("other", [OrderedDict(a=1), print, np.float32(1.0)])
def test_pickle_with_anything_else_is_refused(other: object) -> None:
    with pytest.raises(pickle.UnpicklingError, match="only numpy arrays"):
        ArrayUnpickler(io.BytesIO(pickle.dumps({"kernel": other}))).load()
