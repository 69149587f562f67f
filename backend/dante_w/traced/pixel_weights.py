"""How far pixels are to be trusted: a weight in [0, 1] for each way in which real photos depart from the model.

A texel is the mean of the finest pixels that weigh anything, however little. So what is surely wrong weighs nothing;
where that leaves no pixel, the texture is filled from what is around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Encoded values from here up are taken for clipped.
CLIPPED = 0.995
#: Weight of a clipped pixel where no photo is well exposed: better than nothing.
HOPELESS = 1e-3
#: Linear brightness at which noise and rounding are as large as what the model misses anyhow.
NOISY = 0.01
#: Pixels nearer than this to an edge in depth are mixed with what lies behind it, or the mesh is wrong there.
NEAR_EDGE = 2
#: Deviations from the consensus, in standard deviations, at which a colour is half-way out; what a colour that is too bright is
#: multiplied with: highlights are, and shadows are modelled.
OUTLYING, BRIGHTER = 2.0, 2.0
#: Standard deviation of log albedo where all photos agree.
AGREED = 0.12
#: Outliers of less weight than this are left out.
LEAST = 0.25
#: Photos of a point from which on there is a consensus.
FEWEST = 4


@dataclass(frozen=True)
class Weights:
    """Which weights are in use; each can be left out to measure what it is worth."""

    clipped: bool = True
    dark: bool = True
    edge: bool = True
    outlier: bool = True


ALL = Weights()


def clipped(srgb: np.ndarray, told: np.ndarray) -> np.ndarray:
    """(N,) Clipped colours are darker than what was there: out where other photos tell.

    Args:
        srgb: (N, 3) encoded. told: (N,) bool, whether some photo is not clipped there.
    """
    return np.where((srgb >= CLIPPED).any(axis=1), np.where(told, 0.0, HOPELESS), 1.0)


def dark(brightness: np.ndarray) -> np.ndarray:
    """(N,) Noise and rounding are as large in the dark: linear brightness (N,) against them, as variances."""
    signal = np.square(np.maximum(brightness, 0.0))
    return np.asarray(signal / (signal + NOISY**2))


def edge(distance: np.ndarray) -> np.ndarray:
    """(N,) Beside an edge in depth, (N,) pixels away, colours are mixed and the mesh is wrong: less, but not nothing."""
    return (np.minimum(distance, NEAR_EDGE) + 0.25) / (NEAR_EDGE + 0.25)


@dataclass(frozen=True)
class Consensus:
    """What most photos say of each of C points: `log_albedo` (C, 3), how far they usually are from it, `spread` (C,), and
    whether they are too few to say anything, `few` (C,)."""

    log_albedo: np.ndarray
    spread: np.ndarray
    few: np.ndarray


def consensus(log_albedo: np.ndarray, weight: np.ndarray, point: np.ndarray, light: np.ndarray) -> Consensus:
    """The weighted median of all photos of a point; those that share a light share its errors, so n of them count as the
    square root of n.

    Args:
        log_albedo: (M, 3) of the points as each photo has it. weight: (M,) how much it counts.
        point, light: (M,) indices.
    """
    if len(point) == 0:
        return Consensus(np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool))
    sound = np.isfinite(log_albedo).all(axis=1)
    values = np.where(sound[:, None], log_albedo, 0.0)
    lights = int(light.max()) + 1
    pair = point.astype(np.int64) * lights + light
    weight = np.where(sound, weight, 0.0) / np.sqrt(np.bincount(pair)[pair])
    middle = np.stack([medians(channel, weight, point) for channel in values.T], axis=1)
    distance = np.sqrt(np.square(values - middle[point]).mean(axis=1))
    spread = 1.4826 * medians(distance, weight, point)
    return Consensus(middle, spread, np.bincount(point, weight > 0.0) < FEWEST)


def agreement(log_albedo: np.ndarray, noise: np.ndarray, point: np.ndarray, most: Consensus) -> np.ndarray:
    """(M,) People, highlights, shadows of what is not in the mesh: what a photo says of a point against what most say.

    Args:
        log_albedo: (M, 3) of the points (M,) as photos have it. noise: (M,) its standard deviation.
    """
    sound = np.isfinite(log_albedo).all(axis=1)
    off = np.where(sound[:, None], log_albedo, 0.0) - most.log_albedo[point]
    distance = np.sqrt(np.square(off).mean(axis=1))
    distance = np.where(off.mean(axis=1) > 0.0, BRIGHTER, 1.0) * distance
    ratio = distance / (OUTLYING * np.sqrt(AGREED**2 + most.spread[point] ** 2 + np.square(noise)))
    trust = 1.0 / np.square(1.0 + np.square(ratio))
    return np.where(sound, np.where(most.few[point], 1.0, np.where(trust < LEAST, 0.0, trust)), 0.0)


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
    found = np.zeros(len(total), values.dtype)
    found[known] = values[np.flatnonzero(beyond & (weight > 0.0))[first]]
    return found
