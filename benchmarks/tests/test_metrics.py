"""PSNR and gains, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from measure.metrics import apply_gains, gains, linear_from_srgb, psnr, srgb_from_linear

FACTORS = np.array([0.5, 0.8, 1.1])


def picture(seed: int = 0, low: float = 0.05, high: float = 0.8) -> np.ndarray:
    """(40, 30, 3) sRGB of linear values between `low` and `high`."""
    return srgb_from_linear(np.random.default_rng(seed).uniform(low, high, (40, 30, 3)))


def half() -> np.ndarray:
    mask = np.zeros((40, 30), bool)
    mask[:20] = True
    return mask


@pytest.mark.parametrize(("error", "decibels"), [(0.1, 20.0), (0.01, 40.0), (0.5, 6.0206)])
def test_psnr_of_an_even_error(error: float, decibels: float) -> None:
    truth = np.full((40, 30, 3), 0.5)
    assert psnr(truth + error, truth, half()) == pytest.approx(decibels, abs=1e-3)
    assert psnr(truth - error, truth, half()) == pytest.approx(decibels, abs=1e-3)


def test_psnr_sees_the_mask_only() -> None:
    truth = picture()
    worse = truth + 0.1
    worse[20:] = 0.0
    assert psnr(worse, truth, half()) == pytest.approx(20.0)
    assert psnr(worse, truth, ~half()) < 10.0


def test_psnr_averages_squares_not_decibels() -> None:
    truth = np.zeros((40, 30, 3))
    ours = truth.copy()
    ours[:20] = 0.2
    assert psnr(ours, truth, np.ones((40, 30), bool)) == pytest.approx(-10.0 * np.log10(0.02))


def test_gains_undo_factors_of_linear_light() -> None:
    truth = picture()
    ours = srgb_from_linear(linear_from_srgb(truth) * FACTORS)
    ours[20:] = 1.0  # outside the mask: not asked
    found = gains(ours, truth, half())
    assert found == pytest.approx(1.0 / FACTORS, rel=1e-9)
    assert psnr(apply_gains(ours, found), truth, half()) > 200.0
    assert psnr(ours, truth, half()) < 30.0


def test_gains_are_least_squares() -> None:
    """No other factor brings the linear colours nearer."""
    ours, truth, mask = picture(1), picture(2), half()
    have, want = linear_from_srgb(ours)[mask], linear_from_srgb(truth)[mask]
    best = gains(ours, truth, mask)
    assert best.shape == (3,)

    def error(factors: np.ndarray) -> np.ndarray:
        return ((have * factors - want) ** 2).sum(axis=0)

    for step in (0.99, 1.01):
        assert (error(best * step) > error(best)).all()


def test_gains_of_black_stay_finite() -> None:
    black = np.zeros((40, 30, 3))
    assert np.isfinite(gains(black, picture(), half())).all()


def test_apply_gains_clips_to_what_a_picture_holds() -> None:
    bright = np.full((2, 2, 3), 0.9)
    assert apply_gains(bright, np.array([10.0, 1.0, 0.0]))[0, 0] == pytest.approx([1.0, 0.9, 0.0], abs=1e-6)


def test_srgb_transfer() -> None:
    """IEC 61966-2-1: known pairs, and there and back."""
    assert srgb_from_linear(np.array([0.0, 0.18, 0.5, 1.0])) == pytest.approx(
        [0.0, 0.46136, 0.73536, 1.0], abs=1e-5
    )
    values = np.linspace(0.0, 1.0, 101)
    assert srgb_from_linear(linear_from_srgb(values)) == pytest.approx(values, abs=1e-6)
