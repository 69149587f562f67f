"""What albedo priors, one picture per photo, tell of the shading points.

A network errs alike in neighbouring pixels and, in part, in all views, so a prior weighs little beside the photos: it
settles the level, the tint and the broad shading that photos leave open, and the photos all that is finer. Each
view's own gain per channel, on which networks vary most, is found and taken out.
"""

from __future__ import annotations

import numpy as np

from dante_w.color import linear_from_srgb_array
from dante_w.rays.ray_cache import RayCache
from dante_w.traced.lights import KnownAlbedo, sums
from dante_w.traced.shading_points import ShadingPoints, located

#: What the priors of a point tell, in photos that see it (see `KnownAlbedo`), and the views from which it tells as much.
TRUST, ENOUGH_VIEWS = 0.25, 4
#: Linear albedo below this says only that it is dark.
DARKEST = 3e-3
#: Points that a view must show before half of the gain found for it is believed.
POINTS_FOR_GAIN = 50
ROUNDS = 4


def known_albedo(cache: RayCache, points: ShadingPoints, weight: float = 1.0) -> KnownAlbedo | None:
    """The priors' log albedo of each point, or None where the cache has no prior; `weight` multiplies their trust."""
    if cache.prior is None:
        return None
    rows = [_view(cache, points, k) for k in range(len(cache.starts) - 1)]
    point, log_prior = (np.concatenate(column) for column in zip(*rows, strict=True))
    if len(point) == 0:
        return None
    ends = np.cumsum([0, *(len(row[0]) for row in rows)])
    gain = np.zeros((len(rows), 3), np.float32)
    views = np.bincount(point, minlength=len(points))
    photo = np.repeat(np.arange(len(rows)), np.diff(ends))
    for _ in range(ROUNDS):
        mean = sums(log_prior - gain[photo], point, len(points)) / np.maximum(views, 1)[:, None]
        off = log_prior - mean[point]
        for k in range(len(rows)):
            shown = ends[k + 1] - ends[k]
            if shown:
                gain[k] = np.median(off[ends[k] : ends[k + 1]], axis=0) * shown / (shown + POINTS_FOR_GAIN)
        gain -= gain[np.diff(ends) > 0].mean(axis=0)
    trust = weight * TRUST * np.minimum(views, ENOUGH_VIEWS) / ENOUGH_VIEWS
    return KnownAlbedo(mean, trust.astype(np.float32))


def _view(cache: RayCache, points: ShadingPoints, photo: int) -> tuple[np.ndarray, np.ndarray]:
    """The points (N,) that one view's prior shows, and their mean log albedo (N, 3) in it."""
    assert cache.prior is not None
    part = slice(cache.starts[photo], cache.starts[photo + 1])
    srgb = np.asarray(cache.prior[part], np.float32)
    point = points.at(located(cache, part)[1])
    good = np.isfinite(srgb).all(axis=1) & (point >= 0)
    shown, index, pixels = np.unique(point[good], return_inverse=True, return_counts=True)
    linear = sums(linear_from_srgb_array(srgb[good]), index, len(shown)) / pixels[:, None]
    return shown, np.log(np.maximum(linear, DARKEST))
