"""The albedo that explains photos best under given lights, point by point: what variable projection leaves out of its steps."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from dante_w.core.jit import njit, njit_parallel_fast
from dante_w.traced.state import FAINTEST

#: The residual (log) at which an observation loses half its weight.
OUTLIER = 0.15
_LEAST_LOG = np.float32(math.log(FAINTEST))
#: What is shown is taken to be diffuse by this share at least, and no log is taken to be farther from it than this.
LEAST_DIFFUSE, FARTHEST = np.float32(0.05), np.float32(1.5)
#: How often what is diffuse is told anew, and how often weights are each time.
ROUNDS, REWEIGHTED = 2, 2
_ONE, _LITTLE, _OUTLIER = np.float32(1.0), np.float32(1e-9), np.float32(OUTLIER)


@njit
def by_point(point: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M,) sorted by their point (M,), each point's in their order; and (C + 1,) where each point's begin and end."""
    ends = np.zeros(count + 2, np.int64)
    for c in point:
        ends[c + 2] += 1
    for c in range(count):
        ends[c + 2] += ends[c + 1]
    order = np.empty(len(point), np.int64)
    for row in range(len(point)):
        order[ends[point[row] + 1]] = row
        ends[point[row] + 1] += 1
    return order, ends[:-1]


@njit_parallel_fast
def project_albedo(
    order: np.ndarray,
    ends: np.ndarray,
    log_colour: np.ndarray,
    weight: np.ndarray,
    gloss: np.ndarray,
    photo: np.ndarray,
    log_exposure: np.ndarray,
    light: np.ndarray,
    irradiance: np.ndarray,
    prior: np.ndarray,
    prior_trust: np.ndarray,
    cold: bool,
    log_albedo: np.ndarray,
    over_light: np.ndarray,
    trust: np.ndarray,
    residual: np.ndarray,
    share: np.ndarray,
) -> None:
    """Write what the observations say, see `lights.Projection`, and change `log_albedo` (C, 3) to what explains them best.

    Args:
        order, ends: see `by_point`.
        log_colour, weight, gloss: (M, 3) of the observations; `gloss` is linear. photo: (M,).
        log_exposure, light: (K,) of the photos. irradiance: (C, J, 3).
        prior, prior_trust: (C, 3) and (C,), what is known of log albedo.
        cold: whether nothing is known of albedo yet, and so of the share of gloss.
    """
    for c in prange(len(log_albedo)):
        first = ends[c]
        count = ends[c + 1] - first
        # a point's own observations, row by row: loops over them are SIMD
        own = np.empty((9, count), np.float32)
        shown, own_weight, own_gloss, arriving = own[0], own[1], own[2], own[3]
        part, whole, over, left, believed = own[4], own[5], own[6], own[7], own[8]
        for channel in range(3):
            for i in range(count):
                m = order[first + i]
                shown[i] = log_colour[m, channel] - log_exposure[photo[m]]
                own_weight[i], own_gloss[i] = weight[m, channel], gloss[m, channel]
                arriving[i] = irradiance[c, light[photo[m]], channel]
            log_a = log_albedo[c, channel]
            for turn in range(ROUNDS):
                if cold and turn == 0:
                    for i in range(count):
                        part[i], over[i] = _ONE, shown[i] - math.log(arriving[i])
                else:
                    albedo = math.exp(log_a)
                    for i in range(count):
                        diffuse = albedo * arriving[i]
                        leaving = diffuse + own_gloss[i]
                        part[i] = max(diffuse / leaving, LEAST_DIFFUSE)
                        off = (shown[i] - math.log(leaving)) / part[i]
                        over[i] = log_a + min(max(off, -FARTHEST), FARTHEST)
                for i in range(count):
                    whole[i] = own_weight[i] * part[i] * part[i]
                    believed[i] = whole[i]
                for _ in range(REWEIGHTED):
                    total, told = prior_trust[c] + _LITTLE, prior_trust[c] * prior[c, channel]
                    for i in range(count):
                        total += believed[i]
                        told += believed[i] * over[i]
                    log_a = told / total
                    for i in range(count):
                        left[i] = over[i] - log_a
                        far = part[i] * left[i] / _OUTLIER
                        believed[i] = whole[i] / (_ONE + far * far)
                log_a = max(log_a, _LEAST_LOG)
            log_albedo[c, channel] = log_a
            for i in range(count):
                m = order[first + i]
                over_light[m, channel], residual[m, channel] = over[i], left[i]
                trust[m, channel], share[m, channel] = believed[i], part[i]
