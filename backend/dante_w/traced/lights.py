"""Lights and exposures of the photos by variable projection.

A photo k sees point c as p_ck = exp(g_k) (a_c (T_c . L_j + bounce) + sheen), where j is k's light. In logs the albedo
a_c is one additive number per point, so its best value for given lights is a weighted mean, and damped Gauss-Newton
steps on log L and g alone reach in a dozen steps what gradient descent on everything does not in thousands: the
problem is ill-conditioned, not large (Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", 1973).

What the photos leave open, a prior on log L decides: a Gaussian process on the sphere, rough in brightness and
almost without colour. Colours are linear; "top" is where the brightest albedo is taken to lie (`TOP`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from dante_w.errors import BadInput
from dante_w.traced.gloss import sheen
from dante_w.traced.groups import regroup
from dante_w.traced.shading_points import Observations, ShadingPoints
from dante_w.traced.transfer import Transfer, bounced

#: Albedo of the brightest points, at this quantile of the largest channel: photos leave the scale open, and bounced
#: light and sheen need one.
TOP, BRIGHTEST = 0.5, 0.98
#: Standard deviation and correlation length (radians) of log light over the sphere, brightness and colour; and of its
#: mean colour and level.
BRIGHTNESS, COLOUR, MEAN_COLOUR, LEVEL = (2.0, 0.5), (0.15, 0.8), 0.1, 0.1
#: Standard deviation of a photo's log exposure around the others'.
EXPOSURE = 1.0
#: Relative error of a colour that the model misses anyhow, absolute error of a photo's linear values, and the residual
#: (log) at which an observation loses half its weight.
RELATIVE, ABSOLUTE, OUTLIER = 0.04, 0.004, 0.15
#: What residuals count beside the prior: an observation as one of standard deviation 0.47, since neighbours err alike.
TRUST = 0.1 / 0.15**2
#: Points that Gauss-Newton steps look at.
POINTS = 4000
FEWEST_PHOTOS = 3  # that must see a point
FAINTEST = 1e-5
STEPS = 12
#: No log radiance changes by more than this in a step.
LONGEST_STEP = 1.5
#: Steps after which photos may change their light.
REGROUP = (3, 5, 7)


@dataclass(frozen=True)
class Lights:
    """radiance (J, D, 3) of the lights by direction; light (K,) of each photo; log_exposure (K,) g_k; bounce (C, J, 3)
    irradiance from the mesh itself; albedo (C, 3) of the points, brightest at `TOP`; known (C,) where it is told by the
    photos rather than filled in."""

    radiance: np.ndarray
    light: np.ndarray
    log_exposure: np.ndarray
    bounce: np.ndarray
    albedo: np.ndarray
    known: np.ndarray


def solve_lights(
    points: ShadingPoints,
    transfer: Transfer,
    seen: Observations,
    cameras: np.ndarray,
    light: np.ndarray,
    seed: int,
    progress: Callable[[int, int], None],
) -> Lights:
    """Find the lights that explain the photos.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
        light: (K,) a first guess of which photos share a light, rather too many lights than too few.

    Raises:
        BadInput: too few photos see the same points.
    """
    photos, count = len(light), len(points)
    towards = cameras[seen.photo] - points.position[seen.point]
    towards = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    weight = _weights(seen)
    enough = np.bincount(seen.point, (weight > 0.0).all(axis=1), count) >= FEWEST_PHOTOS
    known = enough & (transfer.direct.sum(axis=1) > 0.02)
    if not known.any():
        raise BadInput(
            "No part of the mesh is well exposed in three photos, which --irradiance traced needs; add photos."
        )
    precision = _prior_precision(transfer.directions)
    generator = np.random.default_rng(seed)

    radiance = np.exp(np.repeat(0.3 * transfer.directions[None, :, 2:], light.max() + 1, axis=0)).repeat(
        3, axis=2
    )
    log_radiance = np.log(radiance).astype(np.float64)
    exposure = _first_exposures(seen, weight, photos)
    bounce = np.zeros((count, len(radiance), 3), np.float32)
    gloss = np.zeros((len(seen.point), 3), np.float32)
    damping, scale = 1.0, 1.0
    for step in range(STEPS + 1):
        radiance = np.exp(log_radiance).astype(np.float32)
        irradiance = np.tensordot(transfer.direct, radiance, axes=(1, 1)) + bounce
        irradiance = np.maximum(irradiance, FAINTEST)
        if step >= 2:
            gloss = sheen(
                seen.point,
                light[seen.photo],
                towards,
                points.normal,
                transfer.directions,
                transfer.visible,
                radiance,
            )
        gain = np.exp(exposure)[seen.photo, None].astype(np.float32)
        diffuse = np.maximum(seen.colour - gain * gloss / scale, 0.15 * seen.colour + FAINTEST)
        target = np.log(diffuse) - exposure[seen.photo, None].astype(np.float32)
        log_albedo, residual, trust = _project(target, irradiance, seen, light, weight)
        albedo = np.exp(log_albedo)
        albedo[~known] = np.median(albedo[known], axis=0)
        scale = TOP / np.quantile(albedo[known].max(axis=1), BRIGHTEST)
        if step == STEPS:
            break
        leaving = np.minimum(albedo * scale, 0.95)[:, None, :] * irradiance
        bounce = bounced(transfer, leaving.reshape(count, -1)).reshape(leaving.shape)
        if step in REGROUP:
            light, kept = regroup(target, np.log(irradiance), log_albedo, weight, seen, light, known)
            log_radiance, bounce = log_radiance[kept], bounce[:, kept]
            progress(step + 1, STEPS)
            continue
        chosen = np.sort(generator.permutation(np.flatnonzero(known))[:POINTS])
        log_change, exposure_change = _gauss_newton(
            chosen, transfer.direct, radiance, irradiance, seen, light, trust, residual,
            log_radiance, exposure, precision, damping,
        )  # fmt: skip
        log_radiance, exposure = log_radiance + log_change, exposure + exposure_change
        damping = max(0.5 * damping, 1e-3)
        progress(step + 1, STEPS)
    return Lights(radiance, light, exposure - np.log(scale), bounce, albedo * scale, known)


def _weights(seen: Observations) -> np.ndarray:
    """(M, 3) how far each observation is to be trusted, about 1 for a mid grey; 0 where it is clipped."""
    dark = (ABSOLUTE / np.maximum(seen.colour, 1e-4)) ** 2
    weight = np.minimum(seen.pixels, 4)[:, None] * RELATIVE**2 / (RELATIVE**2 + dark)
    return np.where(seen.clipped[:, None], 0.0, weight).astype(np.float32)


def _first_exposures(seen: Observations, weight: np.ndarray, photos: int) -> np.ndarray:
    """(K,) each photo's mean log brightness, with mean 0."""
    brightness = np.log(np.maximum(seen.colour, FAINTEST)).mean(axis=1)
    trust = weight.mean(axis=1) + 1e-9
    total = np.bincount(seen.photo, trust, photos)
    mean = np.bincount(seen.photo, trust * brightness, photos) / np.maximum(total, 1e-9)
    return np.where(total > 0.0, mean - mean[total > 0.0].mean(), 0.0)


def _project(
    target: np.ndarray, irradiance: np.ndarray, seen: Observations, light: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best log albedo (C, 3) for given lights, the residuals (M, 3) and their robust weights (M, 3)."""
    over_light = target - np.log(irradiance)[seen.point, light[seen.photo]]
    trust = weight
    for _ in range(3):
        total = sums(trust, seen.point, len(irradiance)) + 1e-9
        log_albedo = sums(trust * over_light, seen.point, len(irradiance)) / total
        residual = over_light - log_albedo[seen.point]
        trust = weight / (1.0 + (residual / OUTLIER) ** 2)
    return log_albedo.astype(np.float32), residual, trust


def sums(values: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32: the rows (M, 3) added up by index (M,)."""
    return np.stack([np.bincount(index, channel, count) for channel in values.T], axis=1).astype(np.float32)


def _prior_precision(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse covariances (D, D) of brightness and of colour over the sphere."""
    apart = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).astype(np.float64)

    def inverse(deviation: float, length: float, mean: float) -> np.ndarray:
        covariance = deviation**2 * np.exp(-apart / length) + mean**2 + 1e-4 * np.eye(len(apart))
        return np.asarray(np.linalg.inv(covariance))

    return inverse(*BRIGHTNESS, LEVEL), inverse(*COLOUR, MEAN_COLOUR)


def _gauss_newton(
    chosen: np.ndarray,
    direct: np.ndarray,
    radiance: np.ndarray,
    irradiance: np.ndarray,
    seen: Observations,
    light: np.ndarray,
    trust: np.ndarray,
    residual: np.ndarray,
    log_radiance: np.ndarray,
    exposure: np.ndarray,
    precision: tuple[np.ndarray, np.ndarray],
    damping: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One damped step on log radiance (J, D, 3) and exposure (K,), albedo eliminated, from the chosen points."""
    lights, count, _ = log_radiance.shape
    size, photos = lights * count, len(exposure)
    renumbered = np.full(len(direct), -1)
    renumbered[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(renumbered[seen.point] >= 0)
    point, photo = renumbered[seen.point[rows]], seen.photo[rows]
    ends = np.searchsorted(photo, np.arange(photos + 1))
    matrix = np.zeros((3 * size + photos, 3 * size + photos), np.float32)
    right = np.zeros(3 * size + photos)
    exposures = slice(3 * size, None)
    for channel in range(3):
        own = slice(channel * size, (channel + 1) * size)
        w, r = trust[rows, channel], residual[rows, channel]
        by_light = np.bincount(point * lights + light[photo], w, len(chosen) * lights).reshape(-1, lights)
        total = by_light.sum(axis=1) + 1e-9
        r = r - (np.bincount(point, w * r, len(chosen)) / total)[point]
        pull = np.bincount(point * lights + light[photo], w * r, len(chosen) * lights).reshape(-1, lights)
        # how the log of a point's irradiance answers to the log of each direction's radiance
        answer = (
            direct[chosen][:, None, :]
            * radiance[None, :, :, channel]
            / irradiance[chosen][:, :, channel, None]
        )
        shared = (answer * (by_light / np.sqrt(total)[:, None])[:, :, None].astype(np.float32)).reshape(
            -1, size
        )
        matrix[own, own] = -(shared.T @ shared)
        for j in range(lights):
            block = slice(channel * size + j * count, channel * size + (j + 1) * count)
            matrix[block, block] += (answer[:, j] * by_light[:, j, None].astype(np.float32)).T @ answer[:, j]
        right[own] = np.einsum("cjd,cj->jd", answer, pull).reshape(-1)
        spread = np.zeros((len(chosen), photos), np.float32)
        spread[point, photo] = w
        cross = -(spread / np.sqrt(total)[:, None].astype(np.float32)).T @ shared
        for k in range(photos):
            mine = slice(ends[k], ends[k + 1])
            block = slice(light[k] * count, (light[k] + 1) * count)
            cross[k, block] += w[mine].astype(np.float32) @ answer[point[mine], light[k]]
        matrix[exposures, own], matrix[own, exposures] = cross, cross.T
        matrix[exposures, exposures] += np.diag(spread.sum(axis=0)) - spread.T @ (spread / total[:, None])
        right[exposures] += np.bincount(photo, w * r, photos)
    system = torch.from_numpy(matrix).double() * TRUST
    right *= TRUST
    _add_prior(system.numpy(), right, log_radiance, exposure, precision)
    system.diagonal().mul_(1.0 + 0.01 * damping).add_(1e-8)
    change = torch.cholesky_solve(torch.from_numpy(right)[:, None], torch.linalg.cholesky(system))[
        :, 0
    ].numpy()
    change *= min(1.0, LONGEST_STEP / max(float(np.abs(change[: 3 * size]).max()), 1e-9))
    return change[: 3 * size].reshape(3, lights, count).transpose(1, 2, 0), change[3 * size :]


def _add_prior(
    system: np.ndarray,
    right: np.ndarray,
    log_radiance: np.ndarray,
    exposure: np.ndarray,
    precision: tuple[np.ndarray, np.ndarray],
) -> None:
    """Add the prior's pull to the normal equations, in place. Channels are laid out one after another."""
    lights, count, _ = log_radiance.shape
    grey = np.full((3, 3), 1.0 / 3.0)
    for matrix, part in zip(precision, (grey, np.eye(3) - grey), strict=True):
        pull = np.einsum("de,jex,xy->yjd", matrix, log_radiance, part).reshape(3, -1)
        for x in range(3):
            right[x * lights * count : (x + 1) * lights * count] -= pull[x]
            for y in range(3):
                for j in range(lights):
                    row, column = (x * lights + j) * count, (y * lights + j) * count
                    system[row : row + count, column : column + count] += part[x, y] * matrix
    photos = np.arange(3 * lights * count, len(right))
    system[photos, photos] += 1.0 / EXPOSURE**2
    right[photos] -= exposure / EXPOSURE**2
