"""Variable projection: under given lights the best log albedo of each point follows in closed form.

A point's own photos and its prior decide alone, by reweighted means: where the residual is large, a photo loses weight
(a Cauchy loss). The model is linearised at the present albedo: with the diffuse fraction f = a E / (a E + S) of what leaves the
surface, the photo's opinion of log albedo is x + r / f, with the weight w f^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel_fast
from dante_w.traced.solver.evidence import Evidence
from dante_w.traced.state import FAINTEST, Lighting


@dataclass(frozen=True)
class ProjectionSettings:
    """Residuals are natural logs."""

    #: Residual at which an observation loses half its weight (sigma of the Cauchy loss): 15% of colour.
    outlier: float = 0.15
    #: The diffuse fraction is taken to be at least this, so that opinions stay finite where all is specular.
    least_diffuse: float = 0.05
    #: No opinion is taken to be farther than this from the present log albedo.
    farthest: float = 1.5
    #: How often the diffuse fraction is computed anew.
    rounds: int = 2
    #: How often observations are weighed in each round.
    reweightings: int = 2


@dataclass(frozen=True)
class Projection:
    """What M observations say of their point's log albedo under given lights. All (M, 3) float32, natural log.

    Attributes:
        log_albedo: each observation's opinion of it.
        weight: how much this counts, robust.
        residual: opinion less the best log albedo; positive where the photo is brighter than the model.
        diffuse: fraction of the modelled colour that is diffuse, in (0, 1].
    """

    log_albedo: np.ndarray
    weight: np.ndarray
    residual: np.ndarray
    diffuse: np.ndarray


def project_albedo(
    lighting: Lighting,
    irradiance: np.ndarray,
    specular: np.ndarray,
    evidence: Evidence,
    settings: ProjectionSettings,
) -> tuple[np.ndarray, Projection]:
    """The log albedo (C, 3) that explains the observations best, float32, and what each of them says of it.

    Args:
        irradiance: (C, J, 3) of the points under the lights.
        specular: (M, 3) specular radiance of the observations, linear, before exposure.
    """
    log_albedo = np.log(np.maximum(lighting.albedo, FAINTEST), dtype=np.float32)
    opinion, weight, residual, diffuse = (np.empty_like(evidence.log_colour) for _ in range(4))
    project_points(
        *evidence.by_point,
        evidence.log_colour,
        evidence.weight,
        specular,
        evidence.observations.photo,
        lighting.log_exposure.astype(np.float32),
        lighting.cluster,
        irradiance,
        evidence.albedo_prior.log_albedo,
        evidence.albedo_prior.weight,
        not lighting.albedo_estimated,
        np.float32(1.0) / np.float32(settings.outlier),
        np.float32(settings.least_diffuse),
        np.float32(settings.farthest),
        settings.rounds,
        settings.reweightings,
        log_albedo,
        opinion,
        weight,
        residual,
        diffuse,
    )
    return log_albedo, Projection(opinion, weight, residual, diffuse)


#: Numerical limits, not tuned: a float32 log, and a weight that keeps a quotient finite.
_LEAST_LOG = np.float32(math.log(FAINTEST))
_ONE, _LEAST_WEIGHT = np.float32(1.0), np.float32(1e-9)


@njit_parallel_fast
def project_points(
    order: np.ndarray,
    ends: np.ndarray,
    log_colour: np.ndarray,
    weight: np.ndarray,
    specular: np.ndarray,
    photo: np.ndarray,
    log_exposure: np.ndarray,
    cluster: np.ndarray,
    irradiance: np.ndarray,
    prior: np.ndarray,
    prior_weight: np.ndarray,
    first: bool,
    per_outlier: float,
    least_diffuse: float,
    farthest: float,
    rounds: int,
    reweightings: int,
    log_albedo: np.ndarray,
    opinion: np.ndarray,
    robust_weight: np.ndarray,
    residual: np.ndarray,
    diffuse: np.ndarray,
) -> None:
    """The kernel of `project_albedo`; fills the last four arrays (M, 3) and changes `log_albedo` (C, 3).

    Args:
        order, ends: see `rows_by_point`.
        log_colour, weight, specular: (M, 3) of the observations. photo: (M,).
        log_exposure, cluster: (K,) of the photos. irradiance: (C, J, 3).
        prior, prior_weight: (C, 3) and (C,) of the prior on log albedo.
        first: whether there is no estimate of albedo yet; all is then taken to be diffuse in the first round.
        per_outlier: one over `ProjectionSettings.outlier`; the others up to `reweightings` are as there.
    """
    for c in prange(len(log_albedo)):
        start = ends[c]
        count = ends[c + 1] - start
        # a point's own observations, row by row: loops over them are SIMD
        rows = np.empty((9, count), np.float32)
        shown, row_weight, row_specular, arriving = rows[0], rows[1], rows[2], rows[3]
        fraction, full_weight, over, rest, reweighted = rows[4], rows[5], rows[6], rows[7], rows[8]
        for channel in range(3):
            for i in range(count):
                m = order[start + i]
                shown[i] = log_colour[m, channel] - log_exposure[photo[m]]
                row_weight[i], row_specular[i] = weight[m, channel], specular[m, channel]
                arriving[i] = irradiance[c, cluster[photo[m]], channel]
            log_a = log_albedo[c, channel]
            for turn in range(rounds):
                if first and turn == 0:
                    for i in range(count):
                        fraction[i], over[i] = _ONE, shown[i] - math.log(arriving[i])
                else:
                    albedo = math.exp(log_a)
                    for i in range(count):
                        from_albedo = albedo * arriving[i]
                        leaving = from_albedo + row_specular[i]
                        fraction[i] = max(from_albedo / leaving, least_diffuse)
                        change = (shown[i] - math.log(leaving)) / fraction[i]
                        over[i] = log_a + min(max(change, -farthest), farthest)
                for i in range(count):
                    full_weight[i] = row_weight[i] * fraction[i] * fraction[i]
                    reweighted[i] = full_weight[i]
                for _ in range(reweightings):
                    total = prior_weight[c] + _LEAST_WEIGHT
                    weighted = prior_weight[c] * prior[c, channel]
                    for i in range(count):
                        total += reweighted[i]
                        weighted += reweighted[i] * over[i]
                    log_a = weighted / total
                    for i in range(count):
                        rest[i] = over[i] - log_a
                        ratio = fraction[i] * rest[i] * per_outlier
                        reweighted[i] = full_weight[i] / (_ONE + ratio * ratio)
                log_a = max(log_a, _LEAST_LOG)
            log_albedo[c, channel] = log_a
            for i in range(count):
                m = order[start + i]
                opinion[m, channel], residual[m, channel] = over[i], rest[i]
                robust_weight[m, channel], diffuse[m, channel] = reweighted[i], fraction[i]
