"""Which photos share a light.

Two photos of one light differ by their exposures alone, so the ratio of their colours is the same at every point that
both see. That makes a first clustering, with too many clusters rather than too few: a cluster split in two costs little,
photos of two lights in one cluster cost a lot. While the lights are solved for, photos move to the light that explains
them best, and lights that explain each other's photos become one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel
from dante_w.traced.observations import Observations
from dante_w.traced.state import Lighting


@dataclass(frozen=True)
class ClusterSettings:
    """How photos are put together by their light at first.

    Attributes:
        clusters: at the start, if there are as many photos.
        compared: photos that are compared with all others; of more, each joins those that it is like.
        common: points that two photos must both see for their ratio to count.
        unrelated: distance (median absolute deviation of log ratios) of photos that share fewer points than others do.
        usual_overlap: that is, fewer than this part of the median number of common points.
        farthest: distance of clusters of which nothing is known.
        dim: brightness (sum of linear channels) below which a ratio is mostly noise.
    """

    clusters: int = 10
    compared: int = 150
    common: int = 150
    unrelated: float = 0.12
    usual_overlap: float = 0.3
    farthest: float = 1.0
    dim: float = 0.05


USUAL_CLUSTERS = ClusterSettings()


@dataclass(frozen=True)
class ReassignmentSettings:
    """How photos move to other lights while lights are solved for. Residuals are natural logs.

    Attributes:
        better: a photo moves if another light's residual is this fraction of its own's.
        outlier: absolute residuals count no more than this.
        smallest: mean residuals count no less than this.
    """

    better: float = 0.97
    outlier: float = 0.4
    smallest: float = 1e-6


USUAL_REASSIGNMENT = ReassignmentSettings()


def first_clusters(
    observations: Observations, points: int, photos: int, settings: ClusterSettings = USUAL_CLUSTERS
) -> np.ndarray:
    """(K,) light of each photo, from ratios of colours alone.

    Of very many photos, `settings.compared` spread evenly among them form the clusters; each of the others joins the cluster whose
    members it is nearest to in the mean.
    """
    brightness = observations.colour.sum(axis=1)
    good = np.flatnonzero(~observations.clipped & (brightness > settings.dim))
    ends = np.searchsorted(observations.photo[good], np.arange(photos + 1))
    point, log = observations.point[good], np.log(brightness[good])
    count = min(photos, settings.compared)
    # one out of each of as many runs of photos, by chance: lights may take turns
    within = np.random.default_rng(0).random(count) if count < photos else 0.0
    chosen = ((np.arange(count) + within) * photos / count).astype(np.int64)
    table = np.full((count, points), np.nan, np.float32)
    for row, k in enumerate(chosen):
        table[row, point[ends[k] : ends[k + 1]]] = log[ends[k] : ends[k + 1]]
    spread, overlaps = np.ones((photos, count)), np.zeros((photos, count), np.int64)
    # a chosen photo is compared with chosen ones before itself alone: each pair once
    below = np.full(photos, photos)
    below[chosen] = chosen
    _compare(table, chosen, below, ends, point, log.astype(np.float32), settings.common, spread, overlaps)
    usual = np.median(overlaps[overlaps > 0]) if (overlaps > 0).any() else 0.0
    distance = np.where(
        overlaps < settings.usual_overlap * usual, np.maximum(spread, settings.unrelated), spread
    )
    known = overlaps >= settings.common
    among, among_known = np.tril(distance[chosen], -1), np.tril(known[chosen], -1)
    labels = _average_linkage(
        among + among.T, settings.clusters, settings.farthest, among_known | among_known.T
    )
    if count == photos:
        return labels
    members = (labels[:, None] == np.arange(labels.max() + 1)).astype(np.float64)
    pairs = known @ members
    mean = np.where(known, distance, 0.0) @ members / np.maximum(pairs, 1.0)
    cluster = np.where(pairs > 0.0, mean, settings.farthest).argmin(axis=1)
    cluster[chosen] = labels
    return np.asarray(cluster)


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
    irradiance: np.ndarray,
    weight: np.ndarray,
    observations: Observations,
    lighting: Lighting,
    as_good: float,
    settings: ReassignmentSettings = USUAL_REASSIGNMENT,
) -> tuple[np.ndarray, np.ndarray]:
    """Move photos and join lights; returns the new light (K,) of each photo and which lights are kept.

    A light is given up if another explains its photos with no more than `as_good` times their residuals: the geometric
    mean of the photos' own ratios, since a photo that no light explains well would drown the others in a ratio of sums.

    Args:
        target: (M, 3) log colours over exposure. irradiance: (C, J, 3), > 0. weight: (M, 3).
    """
    cluster = lighting.cluster
    residual, shows = _residuals(target, np.log(irradiance), weight, observations, lighting, settings.outlier)
    present = residual[np.arange(len(cluster)), cluster]
    moved = np.where(residual.min(axis=1) < settings.better * present, residual.argmin(axis=1), cluster)
    log = np.log(np.maximum(residual, settings.smallest))
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
    weight: np.ndarray,
    observations: Observations,
    lighting: Lighting,
    outlier: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(K, J) what each light leaves unexplained of each photo, up to the exposure that fits best, as a mean of absolute logs;
    and (K,) which photos show anything, the others' are 0. Arguments as of `reassign_photos`."""
    photos, log_albedo = len(lighting.cluster), np.log(lighting.albedo)
    residual, shows = np.zeros((photos, log_irradiance.shape[1])), np.zeros(photos, bool)
    ends = np.searchsorted(observations.photo, np.arange(photos + 1))
    for k in range(photos):
        rows = np.arange(ends[k], ends[k + 1])
        rows = rows[lighting.known[observations.point[rows]] & (weight[rows] > 0.0).all(axis=1)]
        if len(rows) == 0:
            continue
        point, w = observations.point[rows], weight[rows]
        remainder = (target[rows] - log_albedo[point])[:, None, :] - log_irradiance[point]
        offset = (w[:, None] * remainder).sum(axis=(0, 2), keepdims=True) / w.sum()
        bounded = np.minimum(np.abs(remainder - offset), outlier)
        residual[k] = (w[:, None] * bounded).sum(axis=(0, 2)) / w.sum()
        shows[k] = True
    return residual, shows


def _average_linkage(
    distances: np.ndarray, clusters: int, farthest: float, known: np.ndarray | None = None
) -> np.ndarray:
    """(N,) labels from 0 up: the closest two clusters, by mean distance of their members, join until `clusters` are left.

    Not scipy's linkage, which has no distances that are unknown.

    Args:
        distances: (N, N). known: (N, N) bool, which of them count; clusters between which none does join last.
    """
    count = len(distances)
    labels = np.arange(count)
    pairs = np.ones((count, count)) if known is None else known.astype(np.float64)
    distance = np.where(pairs > 0.0, distances, farthest).astype(np.float64)
    np.fill_diagonal(distance, np.inf)
    alive = np.ones(count, bool)
    for _ in range(max(count - clusters, 0)):
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        alive[j] = False
        labels[labels == j] = i
        others = np.flatnonzero(alive & (np.arange(count) != i))
        both = pairs[i, others] + pairs[j, others]
        total = pairs[i, others] * distance[i, others] + pairs[j, others] * distance[j, others]
        distance[i, others] = distance[others, i] = np.where(
            both > 0.0, total / np.maximum(both, 1.0), farthest
        )
        pairs[i, others] = pairs[others, i] = both
        distance[j] = distance[:, j] = np.inf
    return np.unique(labels, return_inverse=True)[1]
