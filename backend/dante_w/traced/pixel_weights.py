"""How far pixels are to be trusted: a weight in [0, 1] for each way in which real photos depart from the model.

A texel is the mean of the finest pixels that weigh anything, however little. So what is surely wrong weighs nothing;
where that leaves no pixel, the texture is filled from its surroundings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PixelWeightSettings:
    """What pixels are weighed by. `python3 dev.py bench robustness SCENE` measures what each weight is worth: it sets one after
    the other to the value that leaves it out.

    Attributes:
        clipped_from: encoded values (sRGB) from here up are taken for clipped; infinity leaves the weight out.
        clipped_alone: weight of a clipped pixel where no photo is well exposed: better than nothing.
        noise: linear brightness at which noise and rounding are as large as what the model misses anyhow; 0 leaves the
            weight out.
        near_edge: pixels nearer than this to an edge in depth are mixed with what lies behind it, or the mesh is wrong
            there; 0 leaves the weight out.
        outlier: deviation from the consensus, in standard deviations, at which a colour loses three quarters of its weight; infinity
            leaves the weight out.
        brighter: what the deviation of too bright a colour is multiplied with: highlights are too bright, and shadows are modelled.
        agreement: standard deviation of log albedo where all photos agree.
        least: outliers of less weight than this are left out.
        fewest_photos: photos of a point from which on there is a consensus.
        clipped_opinion: what a clipped observation counts in the consensus.
    """

    clipped_from: float = 0.995
    clipped_alone: float = 1e-3
    noise: float = 0.01
    near_edge: int = 2
    outlier: float = 2.0
    brighter: float = 2.0
    agreement: float = 0.12
    least: float = 0.25
    fewest_photos: int = 4
    clipped_opinion: float = 0.02


USUAL = PixelWeightSettings()


def clipped_weight(
    srgb: np.ndarray, seen_elsewhere: np.ndarray, settings: PixelWeightSettings = USUAL
) -> np.ndarray:
    """(N,) Clipped colours are darker than what was there: out where other photos show it.

    Args:
        srgb: (N, 3) encoded. seen_elsewhere: (N,) bool, whether some photo is not clipped there.
    """
    instead = np.where(seen_elsewhere, 0.0, settings.clipped_alone)
    return np.where((srgb >= settings.clipped_from).any(axis=1), instead, 1.0)


def dark_weight(brightness: np.ndarray, settings: PixelWeightSettings = USUAL) -> np.ndarray:
    """(N,) Noise and rounding are as large in the dark: linear brightness (N,) against them, as variances."""
    if settings.noise == 0.0:
        return np.ones(len(brightness))
    signal = np.square(np.maximum(brightness, 0.0))
    return np.asarray(signal / (signal + settings.noise**2))


def edge_weight(distance: np.ndarray, settings: PixelWeightSettings = USUAL) -> np.ndarray:
    """(N,) Beside an edge in depth, (N,) pixels away, colours are mixed and the mesh is wrong: less, but not nothing."""
    return (np.minimum(distance, settings.near_edge) + 0.25) / (settings.near_edge + 0.25)


@dataclass(frozen=True)
class Consensus:
    """What most photos show of each of C points: `log_albedo` (C, 3), how far they usually are from it, `spread` (C,), and
    whether they are too few for a consensus, `few` (C,)."""

    log_albedo: np.ndarray
    spread: np.ndarray
    few: np.ndarray


def consensus(
    log_albedo: np.ndarray,
    weight: np.ndarray,
    point: np.ndarray,
    cluster: np.ndarray,
    settings: PixelWeightSettings = USUAL,
) -> Consensus:
    """The weighted median of all photos of a point; those that share a light share its errors, so n of them count as the
    square root of n.

    Args:
        log_albedo: (M, 3) of the points as each photo has it. weight: (M,) how much it counts.
        point, cluster: (M,) indices of the shading point and of the photo's light.
    """
    if len(point) == 0:
        return Consensus(np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool))
    finite = np.isfinite(log_albedo).all(axis=1)
    values = np.where(finite[:, None], log_albedo, 0.0)
    clusters = int(cluster.max()) + 1
    pair = point.astype(np.int64) * clusters + cluster
    weight = np.where(finite, weight, 0.0) / np.sqrt(np.bincount(pair)[pair])
    middle = np.stack([medians(channel, weight, point) for channel in values.T], axis=1)
    distance = np.sqrt(np.square(values - middle[point]).mean(axis=1))
    spread = 1.4826 * medians(distance, weight, point)
    return Consensus(middle, spread, np.bincount(point, weight > 0.0) < settings.fewest_photos)


def consensus_weight(
    log_albedo: np.ndarray,
    noise: np.ndarray,
    point: np.ndarray,
    expected: Consensus,
    settings: PixelWeightSettings = USUAL,
) -> np.ndarray:
    """(M,) People, highlights, shadows of what is not in the mesh: what one photo shows of a point against what most show.

    Args:
        log_albedo: (M, 3) of the points (M,) as photos have it. noise: (M,) its standard deviation.
    """
    finite = np.isfinite(log_albedo).all(axis=1)
    deviation = np.where(finite[:, None], log_albedo, 0.0) - expected.log_albedo[point]
    distance = np.sqrt(np.square(deviation).mean(axis=1))
    distance = np.where(deviation.mean(axis=1) > 0.0, settings.brighter, 1.0) * distance
    usual = np.sqrt(settings.agreement**2 + expected.spread[point] ** 2 + np.square(noise))
    ratio = distance / (settings.outlier * usual)
    weight = 1.0 / np.square(1.0 + np.square(ratio))
    weight = np.where(expected.few[point], 1.0, np.where(weight < settings.least, 0.0, weight))
    return np.where(finite | (settings.outlier == np.inf), weight, 0.0)


def medians(values: np.ndarray, weight: np.ndarray, group: np.ndarray, groups: int = 0) -> np.ndarray:
    """(G,) the weighted median of values (M,) in each of the groups (M,) 0 to G - 1, `groups` at least; 0 without weight.

    >>> medians(np.array([5.0, 1.0, 9.0, 7.0]), np.array([1.0, 1.0, 1.0, 3.0]), np.array([0, 0, 0, 1])).tolist()
    [5.0, 7.0]
    """
    order = np.lexsort((values, group))
    values, weight, group = values[order], weight[order].astype(np.float64), group[order]
    total = np.bincount(group, weight, groups)
    below = np.concatenate([[0.0], np.cumsum(total)[:-1]])
    beyond = np.cumsum(weight) - below[group] >= (0.5 - 1e-9) * total[group]
    known, first = np.unique(group[beyond & (weight > 0.0)], return_index=True)
    middle = np.zeros(len(total), values.dtype)
    middle[known] = values[np.flatnonzero(beyond & (weight > 0.0))[first]]
    return middle
