"""One damped Gauss-Newton step on log radiance and log exposure, with log albedo eliminated.

An observation m of point c in photo k, of light j, is linearised as

    r_m = dx_c + (sum over d of J_cjd dl_jd) + dg_k + s_m du,     J_cjd = T_cd L_jd / E_cj

with the residual r of `Projection`, the changes dx of log albedo, dl of log radiance and dg of log exposure, and du of the log of
the albedo scale. Residuals are divided by the diffuse fraction f and weights multiplied by f^2, so that log albedo is a
plain unknown; dg / f is taken to be dg. dx is eliminated point by point (Schur complement), and how it then falls with light
enters the smoothness prior. Accumulated in float32, solved in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from numba import prange

from dante_w.core.jit import njit_parallel_fast
from dante_w.traced.solver.evidence import ExposurePrior
from dante_w.traced.solver.light_prior import LightPrecision
from dante_w.traced.solver.pcg import PcgSettings, System, solve


@dataclass(frozen=True)
class EquationSettings:
    """What counts how much in a step, and how far it may go."""

    #: Weight kappa of observations beside the light prior: one counts as if its standard deviation were 0.47 (natural log),
    #: since neighbouring points err alike.
    observation_weight: float = 0.1 / 0.15**2
    #: Standard deviation of the log of the albedo scale, which a rule sets: the step allows for its being wrong.
    scale_deviation: float = 0.35
    #: No log radiance changes by more than this in one step: linearisation holds no farther.
    longest_step: float = 1.5
    pcg: PcgSettings = field(default_factory=PcgSettings)


@dataclass(frozen=True)
class Equations:
    """The linearised model of M observations, in rows sorted by photo, of C points, K photos, J lights, D directions.

    Attributes:
        point, photo: (M,) indices.
        weight: (M, 3) of the observations. residual: (M, 3) natural log, positive where the photo is brighter.
        scale_jacobian: (M, 3) derivative of the log colour, divided by f, by the log of the albedo scale: more of the light is
            bounced, less of the colour is specular.
        direct: (C, D) light transport T. irradiance: (C, J, 3). radiance: (J, D, 3). cluster: (K,) light of each photo.
        prior_weight: (C, 3) of the albedo prior. prior_residual: (C, 3) its log albedo less the present one.
        log_albedo: (C, 3) at present.
        smoothness: (C, C) graph Laplacian of the smoothness prior.
        suns: how many of the directions, the last ones, are suns.
        point_weight: how much more all of this counts because points are close together; 1 if they are not.
    """

    point: np.ndarray
    photo: np.ndarray
    weight: np.ndarray
    residual: np.ndarray
    scale_jacobian: np.ndarray
    direct: np.ndarray
    irradiance: np.ndarray
    radiance: np.ndarray
    cluster: np.ndarray
    prior_weight: np.ndarray
    prior_residual: np.ndarray
    log_albedo: np.ndarray
    smoothness: torch.Tensor
    suns: int = 0
    point_weight: float = 1.0


@dataclass(frozen=True)
class Step:
    """A step to take, in natural logs: what is added to log radiance (J, D, 3), to log exposure (K,), and what the log of
    the albedo scale should change by. `damping_factor`: see `pcg.Solution`."""

    log_radiance: np.ndarray
    log_exposure: np.ndarray
    log_albedo_scale: float
    damping_factor: float


def gauss_newton_step(
    equations: Equations,
    log_exposure: np.ndarray,
    exposure_prior: ExposurePrior,
    light_precision: LightPrecision,
    damping: float,
    settings: EquationSettings,
) -> Step:
    """The step that solves the damped normal equations, cut short if it is too long.

    Args:
        log_exposure: (K,) at present.

    Raises:
        DanteError: the equations have no solution.
    """
    lights, directions, _ = equations.radiance.shape
    size, photos = lights * directions, len(log_exposure)
    channels = np.empty((3, size, size), np.float32)
    cross = np.zeros((3, photos + 1, size), np.float32)  # the last row is the albedo scale's
    shared = np.zeros((photos + 1, photos + 1))
    right, right_shared = np.zeros((3, size)), np.zeros(photos + 1)
    for channel in range(3):
        added = _accumulate(channels[channel], cross[channel], right[channel], equations, channel, photos)
        shared += added[0]
        right_shared += added[1]
    log_radiance = np.log(equations.radiance)
    log_radiance[:, directions - equations.suns :] = 0.0  # no prior pulls suns anywhere
    gradient = light_precision.gradient(log_radiance)
    difference = log_exposure - exposure_prior.mean
    weight = settings.observation_weight * equations.point_weight
    right = right * weight - gradient.reshape(3, size)
    shared, right_shared = shared * weight, right_shared * weight
    shared[np.diag_indices(photos)] += 1.0 / exposure_prior.deviation**2
    right_shared[:-1] -= (difference - difference.mean()) / exposure_prior.deviation**2
    shared[-1, -1] += 1.0 / settings.scale_deviation**2
    system = System(
        *(torch.from_numpy(part).double().mul_(weight) for part in (channels, cross)),
        *(torch.from_numpy(part) for part in (shared, light_precision.brightness, light_precision.colour)),
    )
    solution = solve(system, torch.from_numpy(right), torch.from_numpy(right_shared), damping, settings.pcg)
    shortened = min(1.0, settings.longest_step / max(float(solution.x.abs().max()), 1e-9))
    change = solution.x.reshape(3, lights, directions).permute(1, 2, 0).numpy() * shortened
    change_shared = solution.y.numpy() * shortened
    return Step(change, change_shared[:-1], float(change_shared[-1]), solution.damping_factor)


def _accumulate(
    matrix: np.ndarray,
    cross: np.ndarray,
    right: np.ndarray,
    equations: Equations,
    channel: int,
    photos: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Write one channel's equations of log radiance to `matrix` (N, N), `cross` (K + 1, N) and `right` (N,), the latter two
    zero before; returns those of exposures and albedo scale, (K + 1, K + 1) and (K + 1,)."""
    points, (lights, directions, _) = len(equations.direct), equations.radiance.shape
    size = lights * directions
    shared, right_shared = np.zeros((photos + 1, photos + 1)), np.zeros(photos + 1)
    point, photo, cluster = equations.point, equations.photo, equations.cluster
    light = cluster[photo]
    w, r = equations.weight[:, channel], equations.residual[:, channel]
    prior_weight = equations.prior_weight[:, channel]

    def by_light(values: np.ndarray) -> np.ndarray:
        return np.bincount(point * lights + light, values, points * lights).reshape(points, lights)

    light_weight = by_light(w)
    total = light_weight.sum(axis=1) + prior_weight + 1e-9
    mean = (np.bincount(point, w * r, points) + prior_weight * equations.prior_residual[:, channel]) / total
    r = r - mean[point]
    # derivative of a point's log irradiance by the log radiance of each direction
    jacobian = (
        equations.direct[:, None, :]
        * equations.radiance[None, :, :, channel]
        / equations.irradiance[:, :, channel, None]
    )
    # how far the eliminated log albedo falls as log radiance grows; the smoothness prior judges that, exposures escape it
    fall = (jacobian * (light_weight / total[:, None])[:, :, None].astype(np.float32)).reshape(points, size)
    rough = (equations.smoothness @ torch.from_numpy(fall)).numpy()
    right[:] = np.einsum("cjd,cj->jd", jacobian, by_light(w * r)).reshape(-1)
    right += rough.T @ (equations.log_albedo[:, channel] + mean).astype(np.float32)
    rough -= total[:, None].astype(np.float32) * fall
    for j in range(lights):
        columns, earlier = slice(j * directions, (j + 1) * directions), slice(j * directions)
        matrix[columns, : columns.stop] = fall[:, columns].T @ rough[:, : columns.stop]
        weighted = jacobian[:, j] * light_weight[:, j, None].astype(np.float32)
        matrix[columns, columns] += weighted.T @ jacobian[:, j]
        matrix[earlier, columns] = matrix[columns, earlier].T

    # each photo shows few of the points
    ends = np.searchsorted(photo, np.arange(photos + 1))
    _add_over_points(ends, point, -w.astype(np.float32), fall, cross)
    for k in range(photos):
        rows = slice(ends[k], ends[k + 1])
        block = slice(cluster[k] * directions, (cluster[k] + 1) * directions)
        cross[k, block] += w[rows].astype(np.float32) @ jacobian[point[rows], cluster[k]]
    order = np.argsort(point, kind="stable")
    first = np.searchsorted(point[order], np.arange(points + 1))
    _add_pairs(ends, point, -w / total[point], first, photo[order], w[order], shared)
    shared[np.diag_indices(photos)] += np.bincount(photo, w, photos)
    right_shared[:-1] = np.bincount(photo, w * r, photos)

    scale = equations.scale_jacobian[:, channel]
    scale_rest = scale - (np.bincount(point, w * scale, points) / total)[point]
    cross[-1] = np.einsum("cjd,cj->jd", jacobian, by_light(w * scale_rest)).reshape(-1)
    shared[-1, :-1] = shared[:-1, -1] = np.bincount(photo, w * scale_rest, photos)
    shared[-1, -1] = (w * scale_rest * scale).sum()
    right_shared[-1] = (w * scale * r).sum()
    return shared, right_shared


@njit_parallel_fast
def _add_over_points(
    ends: np.ndarray, point: np.ndarray, values: np.ndarray, rows: np.ndarray, out: np.ndarray
) -> None:
    """Add to `out` (K, N) of each photo the rows (C, N) of the points that it shows, each times its value (M,)."""
    for k in prange(len(ends) - 1):
        for m in range(ends[k], ends[k + 1]):
            for n in range(out.shape[1]):
                out[k, n] += values[m] * rows[point[m], n]


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
    """Add to `out` (K, K), over all pairs of observations of one point, `values` (M,) of the one times `others` (M,) of the other.
    The latter, and its `photo` (M,), are sorted by point: those of point c from `first[c]` to `first[c + 1]`."""
    for k in prange(len(ends) - 1):
        for m in range(ends[k], ends[k + 1]):
            for n in range(first[point[m]], first[point[m] + 1]):
                out[k, photo[n]] += values[m] * others[n]
