"""The public entry of the solver: lights, exposures and albedo from photos, from few directions to all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.traced.light_transport import LightTransport, coarser
from dante_w.traced.solver.evidence import Evidence
from dante_w.traced.solver.levenberg_marquardt import minimise
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.state import FAINTEST, Lighting


def solve_lights(
    evidence: Evidence,
    transport: LightTransport,
    start: np.ndarray | Lighting,
    settings: SolverSettings,
    seed: int,
    progress: Callable[[int, int], None],
    fine: bool = True,
) -> Lighting:
    """Find the lights that explain the photos, but for suns.

    Args:
        start: (K,) a first guess of the photos' clusters, rather too many than too few; or coarse lights to go on from, which
            were found with other components or fewer observations.
        progress: called with the steps taken and how many there are.
        fine: whether to take the steps with all directions. Without, lights have `settings.coarse_directions`.

    Raises:
        BadInput: too few photos see the same points.
        DanteError: the equations of a step have no solution.
    """
    known = _known_points(evidence, transport, settings)
    few, coarse_direction = coarser(transport, settings.coarse_directions)
    if isinstance(start, Lighting):
        lighting = _with_expected_exposures(start, evidence)
        first = settings.coarse_steps - settings.continued_steps
    else:
        clusters = start if evidence.components.clusters else np.zeros_like(start)
        lighting, first = _uniform_sky(few, evidence, clusters, settings), 0
    albedo = np.zeros((len(evidence.points), 3), np.float32)
    lighting = replace(lighting, albedo=albedo, albedo_estimated=False, known=known, setbacks=())
    coarse, last = settings.coarse_steps, settings.steps if fine else settings.coarse_steps

    def report(step: int) -> None:
        progress(step - first, last - first)

    lighting = minimise(lighting, few, evidence, settings, range(first, coarse), seed, report)
    if not fine:
        return lighting
    lighting = replace(lighting, radiance=lighting.radiance[:, coarse_direction])
    return minimise(lighting, transport, evidence, settings, range(coarse, last), seed, report)


def _known_points(evidence: Evidence, transport: LightTransport, settings: SolverSettings) -> np.ndarray:
    """(C,) bool: points that enough photos see, unclipped, and that light can reach."""
    clear = (evidence.weight > 0.0).all(axis=1)
    views = np.bincount(evidence.observations.point, clear, len(evidence.points))
    enough = views >= max(min(settings.fewest_photos, views.max(initial=0.0)), 1.0)
    known = enough & (transport.direct.sum(axis=1) > settings.least_open)
    if not known.any():
        raise BadInput(
            "No part of the mesh is well exposed and in the light, which traced light needs; "
            "add photos or take --irradiance field."
        )
    return np.asarray(known)


def _uniform_sky(
    transport: LightTransport, evidence: Evidence, clusters: np.ndarray, settings: SolverSettings
) -> Lighting:
    """The same light for every cluster (K,), a little brighter above; exposures by the photos' brightness if they are free."""
    count = len(evidence.points)
    sky = np.exp(settings.sky_tilt * transport.directions[:, 2])
    radiance = np.tile(sky[None, :, None], (clusters.max() + 1, 1, 3)).astype(np.float32)
    prior = evidence.exposure_prior
    return Lighting(
        radiance,
        clusters,
        _mean_brightness(evidence) if prior.free else prior.mean.astype(np.float64),
        bounce=np.zeros((count, len(radiance), 3), np.float32),
        albedo=np.zeros((count, 3), np.float32),
        known=np.zeros(count, bool),
        brightest_albedo=settings.albedo_scale.brightest,
        albedo_estimated=False,
    )


def _mean_brightness(evidence: Evidence) -> np.ndarray:
    """(K,) each photo's mean log brightness, with mean 0; 0 where it shows nothing."""
    observations, photos = evidence.observations, len(evidence.exposure_prior.mean)
    brightness = np.log(np.maximum(observations.colour, FAINTEST)).mean(axis=1)
    weight = evidence.weight.mean(axis=1) + 1e-9
    total = np.bincount(observations.photo, weight, photos)
    mean = np.bincount(observations.photo, weight * brightness, photos) / np.maximum(total, 1e-9)
    return np.where(total > 0.0, mean - mean[total > 0.0].mean(), 0.0)


def _with_expected_exposures(lighting: Lighting, evidence: Evidence) -> Lighting:
    """With exposures as expected where they are not modelled. What the photos of a light lose by that on average, it takes up."""
    if evidence.components.exposures:
        return lighting
    count, expected = len(lighting.radiance), evidence.exposure_prior.mean
    photos = np.maximum(np.bincount(lighting.cluster, minlength=count), 1)
    lost = np.bincount(lighting.cluster, lighting.log_exposure - expected, count) / photos
    brighter = np.exp(lost).astype(np.float32)[:, None]
    return replace(
        lighting,
        radiance=lighting.radiance * brighter[:, None],
        bounce=lighting.bounce * brighter,
        log_exposure=expected.astype(np.float64),
    )
