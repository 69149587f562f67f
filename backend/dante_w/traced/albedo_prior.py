"""What albedo priors, one picture per photo, say of the shading points.

A network errs alike in neighbouring pixels and, in part, in all views, so a prior weighs little beside the photos: it
settles the level, the tint and the broad shading that photos leave open, and the photos all that is finer. Each
view's own gain per channel, on which networks vary most, is found and taken out. Pixels count as far as the picture's
alpha says they are to be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dante_w.core.arrays import sums
from dante_w.core.color import linear_from_srgb_array
from dante_w.rays.ray_cache import RayCache
from dante_w.traced.pixel_weights import medians
from dante_w.traced.sample_geometry import locate_samples
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.state import AlbedoPrior


@dataclass(frozen=True)
class AlbedoPriorSettings:
    """How priors are fused. Chosen by the recovered albedo with stand-in priors: `bench tradeoff`, `bench stand_in_prior`.

    Attributes:
        weight: of a point's prior, in photos that see it.
        enough_views: views from which on a prior weighs that much.
        darkest: linear albedo below this says only that it is dark.
        points_for_gain: points that a view must show before half of the gain found for it is believed.
        rounds: of finding the views' gains and the points' means in turn.
        least: trust of all views together below which a point's prior is nothing.
    """

    weight: float = 0.05
    enough_views: int = 4
    darkest: float = 3e-3
    points_for_gain: int = 50
    rounds: int = 4
    least: float = 1e-6


USUAL_PRIORS = AlbedoPriorSettings()


def fuse_priors(
    cache: RayCache,
    points: ShadingPoints,
    weight: float = 1.0,
    settings: AlbedoPriorSettings = USUAL_PRIORS,
) -> AlbedoPrior | None:
    """The priors' log albedo of each point, or None where the cache has no prior; `weight` multiplies theirs."""
    if cache.prior is None:
        return None
    rows = [_view(cache, points, k, settings.darkest) for k in range(len(cache.starts) - 1)]
    point, log_prior, sure = (np.concatenate(column) for column in zip(*rows, strict=True))
    if len(point) == 0:
        return None
    ends = np.cumsum([0, *(len(row[0]) for row in rows)])
    gain = np.zeros((len(rows), 3), np.float32)
    views = np.bincount(point, sure, len(points))
    photo = np.repeat(np.arange(len(rows)), np.diff(ends))
    shown = np.bincount(photo, sure, len(rows))
    for _ in range(settings.rounds):
        total = sums(sure[:, None] * (log_prior - gain[photo]), point, len(points))
        mean = total / np.maximum(views, settings.least)[:, None]
        off = log_prior - mean[point]
        middle = np.stack([medians(channel, sure, photo, len(rows)) for channel in off.T], axis=1)
        gain = (middle * (shown / (shown + settings.points_for_gain))[:, None]).astype(np.float32)
        gain -= gain[shown > 0.0].mean(axis=0)
    # of linear albedo: views err up and down, and the mean of their logarithms is darker
    linear = sums(sure[:, None] * np.exp(log_prior - gain[photo]), point, len(points))
    mean = np.log(np.maximum(linear / np.maximum(views, settings.least)[:, None], settings.darkest))
    believed = weight * settings.weight * np.minimum(views, settings.enough_views) / settings.enough_views
    return AlbedoPrior(mean, believed.astype(np.float32))


def _view(
    cache: RayCache, points: ShadingPoints, photo: int, darkest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points (N,) that one view's prior shows, their mean log albedo (N, 3) in it, and how far this is to be trusted (N,)."""
    assert cache.prior is not None
    part = slice(cache.starts[photo], cache.starts[photo + 1])
    prior = np.asarray(cache.prior[part], np.float32)
    point = points.at(locate_samples(cache, part)[1])
    good = np.isfinite(prior).all(axis=1) & (prior[:, 3] > 0.0) & (point >= 0)
    srgb, trust = prior[good, :3], prior[good, 3:]
    shown, index, pixels = np.unique(point[good], return_inverse=True, return_counts=True)
    total = np.bincount(index, trust[:, 0], len(shown))
    linear = sums(trust * linear_from_srgb_array(srgb), index, len(shown)) / total[:, None]
    return shown, np.log(np.maximum(linear, darkest)), total / pixels
