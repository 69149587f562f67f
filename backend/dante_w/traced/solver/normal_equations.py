"""One damped Gauss-Newton step on log light and log exposure, albedo eliminated.

An observation of point c in photo k says log p = g_k + log(a_c E_cj + S), with light j of k, irradiance E linear in the
light's radiance, and sheen S held fixed. With f = a E / (a E + S), the part that is diffuse, its prediction changes by
f (d log a_c + d log E_cj) + d g_k. Residuals here are divided by f and weights multiplied by its square, so that log
albedo is a plain unknown, and d g_k / f is taken for d g_k. It is eliminated point by point (Schur complement).
What the photos leave open, a prior on log light decides: a Gaussian process on the sphere, rough in brightness and
almost without colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numba import prange

from dante_w.core.jit import njit_parallel_fast
from dante_w.traced.solver.pcg import System, solve

#: Standard deviation and correlation length (radians) of log light over the sphere, brightness and colour; and of its
#: mean colour and level. Exposures that are free have the level; where they are known or all one, light has it.
BRIGHTNESS, COLOUR, MEAN_COLOUR, LEVEL, OPEN_LEVEL = (2.0, 0.5), (0.15, 0.8), 0.1, 0.1, 10.0
#: What residuals count beside the prior: an observation as one of standard deviation 0.47, since neighbours err alike.
TRUST = 0.1 / 0.15**2
#: Standard deviation of the log of albedo's level, which a rule sets: steps allow for its being wrong.
UNSURE_LEVEL = 0.35
#: Standard deviation of a step of a sun's log radiance, of which nothing is known beforehand.
SUN_STEP = 0.3
#: No log radiance changes by more than this in a step.
LONGEST_STEP = 1.5


@dataclass(frozen=True)
class Equations:
    """Observations in rows sorted by photo. `point` (M,) counts from 0 to C, `photo` (M,); `weight` and `residual`
    (M, 3) as above; `direct` (C, D); `irradiance` (C, J, 3) of the lights with `radiance` (J, D, 3); `light` (K,) of
    each photo; `level` (M, 3) how the log of what is shown answers, divided by f, to the log of albedo's level: more of
    it is bounced, less is sheen; `known` (C, 3) weight and `known_residual` (C, 3) of what a prior says of log albedo;
    `log_albedo` (C, 3) at present, and `even` (C, C) how far pairs of points are to agree in it, see `evenness`. The last of the D
    directions are `suns`. All that is said of points counts `counts` times `TRUST`.
    """

    point: np.ndarray
    photo: np.ndarray
    weight: np.ndarray
    residual: np.ndarray
    direct: np.ndarray
    irradiance: np.ndarray
    radiance: np.ndarray
    light: np.ndarray
    level: np.ndarray
    known: np.ndarray
    known_residual: np.ndarray
    log_albedo: np.ndarray
    even: torch.Tensor
    suns: int = 0
    counts: float = 1.0


@dataclass(frozen=True)
class ExposurePrior:
    """Log exposures (K,) as known beforehand, and how far (standard deviation) they may be from that."""

    mean: np.ndarray
    deviation: float


def prior_precision(
    directions: np.ndarray, suns: int = 0, level: float = LEVEL
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse covariances (D, D) of brightness, whose mean has the standard deviation `level`, and of colour over the sphere,
    and of how far suns, the last of the directions, may go in a step."""
    parts = directions[: len(directions) - suns]
    apart = np.arccos(np.clip(parts @ parts.T, -1.0, 1.0)).astype(np.float64)

    def inverse(deviation: float, length: float, mean: float) -> np.ndarray:
        covariance = deviation**2 * np.exp(-apart / length) + mean**2 + 1e-4 * np.eye(len(apart))
        padded = np.pad(np.linalg.inv(covariance), (0, suns))
        return padded + np.diag(np.r_[np.zeros(len(parts)), np.full(suns, SUN_STEP**-2)])

    return inverse(*BRIGHTNESS, level), inverse(*COLOUR, MEAN_COLOUR)


def step(
    equations: Equations,
    exposure: np.ndarray,
    expected: ExposurePrior,
    precision: tuple[np.ndarray, np.ndarray],
    damping: float,
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """The changes of log radiance (J, D, 3), of exposure (K,) and of the log of albedo's level; and 1, or one over
    what the damping had to be multiplied with."""
    lights, count, _ = equations.radiance.shape
    size, photos = lights * count, len(exposure)
    own = np.empty((3, size, size), np.float32)
    cross = np.zeros((3, photos + 1, size), np.float32)  # the last one is the level's
    shared = np.zeros((photos + 1, photos + 1))
    right, right_shared = np.zeros((3, size)), np.zeros(photos + 1)
    for channel in range(3):
        told = _channel(own[channel], cross[channel], right[channel], equations, channel, photos)
        shared += told[0]
        right_shared += told[1]
    log_radiance = np.log(equations.radiance)
    log_radiance[:, count - equations.suns :] = 0.0  # suns are not pulled anywhere
    brightness, tint = precision
    mean = log_radiance.mean(axis=2, keepdims=True)
    pull = np.einsum("de,jex->xjd", brightness, mean) + np.einsum("de,jex->xjd", tint, log_radiance - mean)
    away = exposure - expected.mean
    trust = TRUST * equations.counts
    right = right * trust - pull.reshape(3, size)
    shared, right_shared = shared * trust, right_shared * trust
    shared[np.diag_indices(photos)] += 1.0 / expected.deviation**2
    right_shared[:-1] -= (away - away.mean()) / expected.deviation**2
    shared[-1, -1] += 1.0 / UNSURE_LEVEL**2
    observed = (torch.from_numpy(part).double().mul_(trust) for part in (own, cross))
    system = System(*observed, *(torch.from_numpy(part) for part in (shared, brightness, tint)))
    change, further, harder = solve(system, torch.from_numpy(right), torch.from_numpy(right_shared), damping)
    shorter = min(1.0, LONGEST_STEP / max(float(change.abs().max()), 1e-9))
    radiance = change.reshape(3, lights, count).permute(1, 2, 0).numpy() * shorter
    rest = further.numpy() * shorter
    return radiance, rest[:-1], float(rest[-1]), 1.0 / harder


def _channel(
    own: np.ndarray, cross: np.ndarray, right: np.ndarray, of: Equations, channel: int, photos: int
) -> tuple[np.ndarray, np.ndarray]:
    """What one channel's observations say: of its log radiance, to write to `own` (N, N), `cross` (K + 1, N) and `right` (N,) of
    zeros; and (K + 1, K + 1) and (K + 1,) of exposures and level."""
    points, (lights, count, _) = len(of.direct), of.radiance.shape
    size = lights * count
    shared, right_shared = np.zeros((photos + 1, photos + 1)), np.zeros(photos + 1)
    point, photo, light = of.point, of.photo, of.light[of.photo]
    w, r, known = of.weight[:, channel], of.residual[:, channel], of.known[:, channel]

    def by_light(values: np.ndarray) -> np.ndarray:
        return np.bincount(point * lights + light, values, points * lights).reshape(points, lights)

    trust = by_light(w)
    total = trust.sum(axis=1) + known + 1e-9
    best = (np.bincount(point, w * r, points) + known * of.known_residual[:, channel]) / total
    r = r - best[point]
    # how the log of a point's irradiance answers to the log of each direction's radiance
    answer = of.direct[:, None, :] * of.radiance[None, :, :, channel] / of.irradiance[:, :, channel, None]
    # the log albedo that is eliminated falls as light grows, and is to be even; exposures are not asked that
    falls = (answer * (trust / total[:, None])[:, :, None].astype(np.float32)).reshape(points, size)
    uneven = (of.even @ torch.from_numpy(falls)).numpy()
    right[:] = np.einsum("cjd,cj->jd", answer, by_light(w * r)).reshape(-1)
    right += uneven.T @ (of.log_albedo[:, channel] + best).astype(np.float32)
    uneven -= total[:, None].astype(np.float32) * falls
    for j in range(lights):
        columns, earlier = slice(j * count, (j + 1) * count), slice(j * count)
        own[columns, : columns.stop] = falls[:, columns].T @ uneven[:, : columns.stop]
        own[columns, columns] += (answer[:, j] * trust[:, j, None].astype(np.float32)).T @ answer[:, j]
        own[earlier, columns] = own[columns, earlier].T

    # each photo sees few of the points
    ends = np.searchsorted(photo, np.arange(photos + 1))
    _add_over_points(ends, point, -w.astype(np.float32), falls, cross)
    for k in range(photos):
        mine = slice(ends[k], ends[k + 1])
        block = slice(of.light[k] * count, (of.light[k] + 1) * count)
        cross[k, block] += w[mine].astype(np.float32) @ answer[point[mine], of.light[k]]
    order = np.argsort(point, kind="stable")
    first = np.searchsorted(point[order], np.arange(points + 1))
    _add_pairs(ends, point, -w / total[point], first, photo[order], w[order], shared)
    shared[np.diag_indices(photos)] += np.bincount(photo, w, photos)
    right_shared[:-1] = np.bincount(photo, w * r, photos)

    own_level = of.level[:, channel]
    level = own_level - (np.bincount(point, w * own_level, points) / total)[point]
    cross[-1] = np.einsum("cjd,cj->jd", answer, by_light(w * level)).reshape(-1)
    shared[-1, :-1] = shared[:-1, -1] = np.bincount(photo, w * level, photos)
    shared[-1, -1] = (w * level * own_level).sum()
    right_shared[-1] = (w * own_level * r).sum()
    return shared, right_shared


@njit_parallel_fast
def _add_over_points(
    ends: np.ndarray, point: np.ndarray, values: np.ndarray, of_points: np.ndarray, out: np.ndarray
) -> None:
    for k in prange(len(ends) - 1):
        for m in range(ends[k], ends[k + 1]):
            for n in range(out.shape[1]):
                out[k, n] += values[m] * of_points[point[m], n]


@njit_parallel_fast
def _add_pairs(
    ends: np.ndarray,
    point: np.ndarray,
    values: np.ndarray,
    first: np.ndarray,
    photo: np.ndarray,
    others: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add up (K, K) over all pairs of observations of a point `values` (M,) of the one times `others` (M,) of the other, which
    with its `photo` (M,) is in the order of points, from `first[c]` to `first[c + 1]`."""
    for k in prange(len(ends) - 1):
        for m in range(ends[k], ends[k + 1]):
            for n in range(first[point[m]], first[point[m] + 1]):
                out[k, photo[n]] += values[m] * others[n]
