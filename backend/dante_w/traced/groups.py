"""Which photos share a light.

Two photos of one light differ by their exposures alone, so the ratio of their colours is the same at every point that
both see. That makes a first grouping, with too many groups rather than too few: a group split in two costs little,
photos of two lights in one group cost a lot. While the lights are solved for, photos move to the light that explains
them best, and lights that explain each other's photos become one.
"""

from __future__ import annotations

import numpy as np

from dante_w.traced.shading_points import Observations

#: Groups at the start, if there are as many photos.
GROUPS = 10
#: Points that two photos must both see for their ratio to say something; with fewer they count as `UNRELATED`.
COMMON, UNRELATED = 150, 0.12
#: Brightness (sum of linear channels) below which a ratio is mostly noise.
DIM = 0.05
#: A photo moves if another light's residual is this fraction of its own's; a light is given up if another explains its
#: photos with no more than this multiple of the residual.
BETTER, AS_GOOD = 0.97, 1.25
OUTLIER = 0.4  # log residuals count no more than this


def first_groups(seen: Observations, points: int, photos: int) -> np.ndarray:
    """(K,) light of each photo, from ratios of colours alone."""
    brightness = seen.colour.sum(axis=1)
    logs = np.full((photos, points), np.nan, np.float32)
    good = ~seen.clipped & (brightness > DIM)
    logs[seen.photo[good], seen.point[good]] = np.log(brightness[good])
    apart = np.full((photos, photos), UNRELATED)
    overlaps = np.zeros((photos, photos))
    for i in range(photos):
        for j in range(i):
            ratio = logs[i] - logs[j]
            ratio = ratio[np.isfinite(ratio)]
            overlaps[i, j] = len(ratio)
            if len(ratio) >= COMMON:
                apart[i, j] = np.median(np.abs(ratio - np.median(ratio)))
            else:
                apart[i, j] = 1.0
    usual = np.median(overlaps[overlaps > 0]) if (overlaps > 0).any() else 0.0
    apart = np.where(overlaps < 0.3 * usual, np.maximum(apart, UNRELATED), apart)
    apart = np.tril(apart, -1)
    return _average_linkage(apart + apart.T, GROUPS)


def regroup(
    target: np.ndarray,
    log_irradiance: np.ndarray,
    log_albedo: np.ndarray,
    weight: np.ndarray,
    seen: Observations,
    light: np.ndarray,
    known: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Move photos and join lights; returns the new light (K,) of each photo and which lights are kept.

    Args:
        target: (M, 3) log colours over exposure. log_irradiance: (C, J, 3). log_albedo: (C, 3).
    """
    photos, lights = len(light), log_irradiance.shape[1]
    cost = np.full((photos, lights), np.inf)
    ends = np.searchsorted(seen.photo, np.arange(photos + 1))
    for k in range(photos):
        rows = np.arange(ends[k], ends[k + 1])
        rows = rows[known[seen.point[rows]] & (weight[rows] > 0.0).all(axis=1)]
        if len(rows) == 0:
            cost[k] = 0.0
            continue
        point, w = seen.point[rows], weight[rows]
        left = (target[rows] - log_albedo[point])[:, None, :] - log_irradiance[point]
        offset = (w[:, None] * left).sum(axis=(0, 2), keepdims=True) / w.sum()
        cost[k] = (w[:, None] * np.minimum(np.abs(left - offset), OUTLIER)).sum(axis=(0, 2)) / w.sum()
    everyone = np.arange(photos)
    moved = np.where(cost.min(axis=1) < BETTER * cost[everyone, light], cost.argmin(axis=1), light)
    for j in np.argsort(np.bincount(moved, minlength=lights), kind="stable"):
        members = np.flatnonzero(moved == j)
        others = [i for i in np.unique(moved) if i != j]
        if len(members) == 0 or not others:
            continue
        means = cost[members][:, others].mean(axis=0)
        if means.min() <= AS_GOOD * cost[members, j].mean():
            moved[members] = others[int(means.argmin())]
    kept, renumbered = np.unique(moved, return_inverse=True)
    return renumbered, kept


def _average_linkage(apart: np.ndarray, groups: int) -> np.ndarray:
    """(N,) labels from 0 up: the closest two groups, by mean distance of their members, join until `groups` are left."""
    labels = np.arange(len(apart))
    sizes = np.ones(len(apart))
    distance = apart.astype(np.float64)
    np.fill_diagonal(distance, np.inf)
    for _ in range(max(len(apart) - groups, 0)):
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        merged = (sizes[i] * distance[i] + sizes[j] * distance[j]) / (sizes[i] + sizes[j])
        distance[i], distance[:, i] = merged, merged
        distance[i, i] = distance[j] = distance[:, j] = np.inf
        sizes[i] += sizes[j]
        labels[labels == j] = i
    return np.unique(labels, return_inverse=True)[1]
