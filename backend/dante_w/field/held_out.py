"""How well photos that the fit never saw are re-rendered."""

from __future__ import annotations

import numpy as np

from dante_w.field.fields import Model
from dante_w.field.optimise import LossTerms, Progress, Schedule, fit, photo_ranges, psnr
from dante_w.rays.ray_cache import RayCache
from dante_w.run.setbacks import Setback

#: Horizontal bands of a held-out photo that take turns in fitting and scoring.
BANDS = 32
#: Enough for the handful of numbers that belong to a single photo.
SCHEDULE = Schedule(steps=100, batch=1 << 13, learning_rate=2e-2)


def held_out_psnr(
    model: Model, cache: RayCache, held_out: np.ndarray, seed: int, progress: Progress
) -> tuple[float | None, list[Setback]]:
    """PSNR in dB of the re-rendered held-out photos (sRGB), their mean, or None if they see nothing; and setbacks on the way.

    A held-out photo has a light and an exposure of its own, which no other photo tells. So its embedding,
    exposure and offset, and nothing else, are fitted on one half of its pixels, in bands, and the score is
    taken on the other half (as in NeRF-W, section 4).
    """
    ranges = photo_ranges(cache, held_out)
    fitted = _bands(ranges)[0]
    scored = [half for own in ranges if len(half := _bands(own[None])[1])]
    if len(scored) == 0 or len(fitted) == 0:
        return None, []
    terms = LossTerms(prior_weight=0.0)
    course = fit(model, cache, fitted, terms, SCHEDULE, seed, progress, model.photo_parameters())
    scores = [psnr(model, cache, np.concatenate([np.arange(*band) for band in half])) for half in scored]
    return float(np.mean(scores)), course.setbacks


def _bands(ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split each range (first, end) into `BANDS` pieces; the even ones and the odd ones, both (R, 2)."""
    cuts = np.linspace(ranges[:, 0], ranges[:, 1], BANDS + 1, axis=1).astype(np.int64)
    pieces = np.stack([cuts[:, :-1], cuts[:, 1:]], axis=2)
    even, odd = pieces[:, ::2].reshape(-1, 2), pieces[:, 1::2].reshape(-1, 2)
    return even[even[:, 1] > even[:, 0]], odd[odd[:, 1] > odd[:, 0]]
