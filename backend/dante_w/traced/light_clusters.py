"""Which photos share a light.

Two photos of one light differ by their exposures alone, so the ratio of their colours is the same at every point that
both see. That makes a first grouping, with too many groups rather than too few: a group split in two costs little,
photos of two lights in one group cost a lot. While the lights are solved for, photos move to the light that explains
them best, and lights that explain each other's photos become one.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel
from dante_w.traced.shading_points import Observations

#: Groups at the start, if there are as many photos.
CLUSTERS = 10
#: Photos that are compared with all others; of more, each joins what it is like.
COMPARED = 150
#: Points that two photos must both see for their ratio to say something; with fewer they count as `UNRELATED`.
COMMON, UNRELATED = 150, 0.12
#: Distance of groups of which nothing is known.
FARTHEST = 1.0
#: Brightness (sum of linear channels) below which a ratio is mostly noise.
DIM = 0.05
#: A photo moves if another light's residual is this fraction of its own's.
BETTER = 0.97
#: Log residuals count no more than this, and their means no less.
OUTLIER, SMALLEST = 0.4, 1e-6


def first_clusters(seen: Observations, points: int, photos: int) -> np.ndarray:
    """(K,) light of each photo, from ratios of colours alone.

    Of very many photos, `COMPARED` spread evenly among them form the groups; each of the others joins the group whose members
    it is nearest to in the mean.
    """
    brightness = seen.colour.sum(axis=1)
    good = np.flatnonzero(~seen.clipped & (brightness > DIM))
    ends = np.searchsorted(seen.photo[good], np.arange(photos + 1))
    point, log = seen.point[good], np.log(brightness[good])
    count = min(photos, COMPARED)
    # one out of each of as many runs of photos, by chance: lights may take turns
    within = np.random.default_rng(0).random(count) if count < photos else 0.0
    chosen = ((np.arange(count) + within) * photos / count).astype(np.int64)
    table = np.full((count, points), np.nan, np.float32)
    for row, k in enumerate(chosen):
        table[row, point[ends[k] : ends[k + 1]]] = log[ends[k] : ends[k + 1]]
    spread, overlaps = np.ones((photos, count)), np.zeros((photos, count), np.int64)
    below = np.full(
        photos, photos
    )  # with chosen photos before itself alone is a chosen one compared: each pair once
    below[chosen] = chosen
    _compare(table, chosen, below, ends, point, log.astype(np.float32), COMMON, spread, overlaps)
    usual = np.median(overlaps[overlaps > 0]) if (overlaps > 0).any() else 0.0
    apart = np.where(overlaps < 0.3 * usual, np.maximum(spread, UNRELATED), spread)
    known = overlaps >= COMMON
    among, told = np.tril(apart[chosen], -1), np.tril(known[chosen], -1)
    labels = _average_linkage(among + among.T, CLUSTERS, told | told.T)
    if count == photos:
        return labels
    members = (labels[:, None] == np.arange(labels.max() + 1)).astype(np.float64)
    pairs = known @ members
    mean = np.where(known, apart, 0.0) @ members / np.maximum(pairs, 1.0)
    light = np.where(pairs > 0.0, mean, FARTHEST).argmin(axis=1)
    light[chosen] = labels
    return np.asarray(light)


@njit_parallel
def _compare(
    table: np.ndarray,
    chosen: np.ndarray,
    below: np.ndarray,
    ends: np.ndarray,
    point: np.ndarray,
    log: np.ndarray,
    common: int,
    spread: np.ndarray,
    overlaps: np.ndarray,
) -> None:
    """How much the ratio of two photos' colours varies, (K, N), the mean distance from its median taken as a median too, and at
    how many points it is known; 1 if these are fewer than `common`.

    Args:
        table: (N, C) log brightness in the chosen photos (N,), in ascending order, NaN where not seen. below: (K,) what a
            chosen photo's number is below to be compared. ends, point, log: brightness in all photos, in rows.
    """
    for k in prange(len(ends) - 1):
        ratio = np.empty(ends[k + 1] - ends[k], np.float32)
        for i in range(len(table)):
            if chosen[i] >= below[k]:
                break
            count = 0
            for m in range(ends[k], ends[k + 1]):
                other = table[i, point[m]]
                if not np.isnan(other):
                    ratio[count] = log[m] - other
                    count += 1
            overlaps[k, i] = count
            if count >= common:
                spread[k, i] = np.median(np.abs(ratio[:count] - np.median(ratio[:count])))


def reassign_photos(
    target: np.ndarray,
    log_irradiance: np.ndarray,
    log_albedo: np.ndarray,
    weight: np.ndarray,
    seen: Observations,
    light: np.ndarray,
    known: np.ndarray,
    as_good: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Move photos and join lights; returns the new light (K,) of each photo and which lights are kept.

    A light is given up if another explains its photos with no more than `as_good` times their residuals: the geometric
    mean of the photos' own ratios, since a photo that no light explains well would drown the others in a ratio of sums.

    Args:
        target: (M, 3) log colours over exposure. log_irradiance: (C, J, 3). log_albedo: (C, 3).
    """
    residual, shows = _residuals(target, log_irradiance, log_albedo, weight, seen, len(light), known)
    own = residual[np.arange(len(light)), light]
    moved = np.where(residual.min(axis=1) < BETTER * own, residual.argmin(axis=1), light)
    log = np.log(np.maximum(residual, SMALLEST))
    for j in np.argsort(np.bincount(moved, minlength=residual.shape[1]), kind="stable"):
        members = np.flatnonzero(moved == j)
        others = np.setdiff1d(moved, j)
        if len(members) == 0 or len(others) == 0:
            continue
        telling = members[shows[members]]
        worse = (log[telling][:, others] - log[telling, j][:, None]).sum(axis=0) / max(len(telling), 1)
        if worse.min() <= np.log(as_good):
            moved[members] = others[int(worse.argmin())]
    kept, renumbered = np.unique(moved, return_inverse=True)
    return renumbered, kept


def _residuals(
    target: np.ndarray,
    log_irradiance: np.ndarray,
    log_albedo: np.ndarray,
    weight: np.ndarray,
    seen: Observations,
    photos: int,
    known: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(K, J) what each light leaves unexplained of each photo, up to the exposure that fits best, as a mean of absolute logs;
    and (K,) which photos show anything, the others' are 0. Arguments as of `regroup`."""
    residual, shows = np.zeros((photos, log_irradiance.shape[1])), np.zeros(photos, bool)
    ends = np.searchsorted(seen.photo, np.arange(photos + 1))
    for k in range(photos):
        rows = np.arange(ends[k], ends[k + 1])
        rows = rows[known[seen.point[rows]] & (weight[rows] > 0.0).all(axis=1)]
        if len(rows) == 0:
            continue
        point, w = seen.point[rows], weight[rows]
        left = (target[rows] - log_albedo[point])[:, None, :] - log_irradiance[point]
        offset = (w[:, None] * left).sum(axis=(0, 2), keepdims=True) / w.sum()
        residual[k] = (w[:, None] * np.minimum(np.abs(left - offset), OUTLIER)).sum(axis=(0, 2)) / w.sum()
        shows[k] = True
    return residual, shows


def _average_linkage(apart: np.ndarray, groups: int, known: np.ndarray | None = None) -> np.ndarray:
    """(N,) labels from 0 up: the closest two groups, by mean distance of their members, join until `groups` are left.

    Args:
        apart: (N, N) distances. known: (N, N) bool, which of them count; groups between which none does join last.
    """
    count = len(apart)
    labels = np.arange(count)
    pairs = np.ones((count, count)) if known is None else known.astype(np.float64)
    distance = np.where(pairs > 0.0, apart, FARTHEST).astype(np.float64)
    np.fill_diagonal(distance, np.inf)
    left = np.ones(count, bool)
    for _ in range(max(count - groups, 0)):
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        left[j] = False
        labels[labels == j] = i
        others = np.flatnonzero(left & (np.arange(count) != i))
        both = pairs[i, others] + pairs[j, others]
        total = pairs[i, others] * distance[i, others] + pairs[j, others] * distance[j, others]
        distance[i, others] = distance[others, i] = np.where(
            both > 0.0, total / np.maximum(both, 1.0), FARTHEST
        )
        pairs[i, others] = pairs[others, i] = both
        distance[j] = distance[:, j] = np.inf
    return np.unique(labels, return_inverse=True)[1]
