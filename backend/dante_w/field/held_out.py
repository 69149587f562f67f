"""How well photos that the fit never saw are re-rendered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dante_w.field.fields import FieldModel
from dante_w.field.inference import psnr
from dante_w.field.optimise import FIT, FitSettings, Problem, Progress, Schedule, fit, photo_ranges
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import RayCache
from dante_w.run.setbacks import Setback

#: Enough for the handful of numbers that belong to a single photo.
PHOTO_SCHEDULE = Schedule(steps=100, batch=1 << 13, learning_rate=2e-2)


@dataclass(frozen=True)
class HeldOutSettings:
    """How a held-out photo's own numbers are fitted, and where it is scored."""

    #: Horizontal bands of a photo that take turns in fitting and scoring: both halves see all of the object.
    bands: int = 32
    #: Of the fit.
    schedule: Schedule = PHOTO_SCHEDULE


HELD_OUT = HeldOutSettings()


def held_out_psnr(
    model: FieldModel,
    cache: RayCache,
    held_out: np.ndarray,
    seed: int,
    progress: Progress,
    settings: HeldOutSettings = HELD_OUT,
    fit_settings: FitSettings = FIT,
) -> tuple[float | None, list[Setback]]:
    """PSNR in dB of the re-rendered held-out photos (sRGB), their mean, or None if they see nothing; and the fit's setbacks.

    A held-out photo has a light and an exposure of its own, which no other photo shows. So its embedding,
    exposure and offset, and nothing else, are fitted on one half of its pixels, in bands, and the score is
    taken on the other half (as in NeRF-W, section 4).

    Args:
        held_out: indices of the photos.
    """
    ranges = photo_ranges(cache, held_out)
    fitted = halves(ranges, settings.bands)[0]
    scored = [half for each in ranges if len(half := halves(each[None], settings.bands)[1])]
    if len(scored) == 0 or len(fitted) == 0:
        return None, []
    problem = Problem(model, cache, fitted, LossTerms(prior_weight=0.0), model.photo_parameters())
    result = fit(problem, settings.schedule, seed, progress, fit_settings)
    scores = [psnr(model, cache, np.concatenate([np.arange(*band) for band in half])) for half in scored]
    return float(np.mean(scores)), result.setbacks


def halves(ranges: np.ndarray, bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Split each range (first, end) into so many bands; the even ones and the odd ones, both (R, 2)."""
    cuts = np.linspace(ranges[:, 0], ranges[:, 1], bands + 1, axis=1).astype(np.int64)
    pieces = np.stack([cuts[:, :-1], cuts[:, 1:]], axis=2)
    even, odd = pieces[:, ::2].reshape(-1, 2), pieces[:, 1::2].reshape(-1, 2)
    return even[even[:, 1] > even[:, 0]], odd[odd[:, 1] > odd[:, 0]]
