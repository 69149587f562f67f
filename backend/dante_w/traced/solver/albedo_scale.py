"""Albedo scale and white balance: the gain per channel that photos leave open between albedo and light.

With an albedo prior it is the ratio of the means of linear albedo, the prior's over the solution's. Without, the brightest albedo
is taken to have a certain value, and the white balance follows from the light prior: light is white on average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dante_w.traced.solver.evidence import Evidence
from dante_w.traced.state import Lighting


@dataclass(frozen=True)
class AlbedoScaleSettings:
    """The rule for the brightest albedo, linear."""

    #: What the brightest albedo is taken to be at first: most things have something light grey on them.
    brightest: float = 0.5
    #: Quantile of the points' largest channel that counts as the brightest albedo: few points are errors.
    quantile: float = 0.98
    #: Number of the step, from 0, after which specular and bounced light, which depend on the true scale, correct it once.
    step: int = 13
    #: How much of that correction, in logarithms, is taken: the true scale of rendered objects follows it by a slope of about
    #: 0.5 (`bench gigalit`).
    correction: float = 0.55
    #: Bounds of the corrected value.
    bounds: tuple[float, float] = (0.25, 0.9)


@dataclass(frozen=True)
class Gain:
    """What moves from light to albedo, in natural logs.

    Attributes:
        albedo: (3,) float32, added to log albedo everywhere.
        exposure: subtracted from all log exposures.
        light: (3,) float32, subtracted from the log radiance of all lights.
    """

    albedo: np.ndarray
    exposure: float
    light: np.ndarray


def open_gain(
    log_albedo: np.ndarray, lighting: Lighting, evidence: Evidence, settings: AlbedoScaleSettings
) -> Gain:
    """The gain that gives the albedo its scale and white balance. Exposures take up the scale if they are free, else lights do;
    lights take up the white balance.

    Args:
        log_albedo: (C, 3) as it was projected, float32.
    """
    photos = np.bincount(evidence.observations.point, minlength=len(evidence.points))
    prior = evidence.albedo_prior
    weight = prior.weight * lighting.known * photos
    white_balance = np.zeros(3, np.float32)
    if weight.any():
        # linear albedo, since the prior's noise has no mean there
        target, solution = (
            weight @ np.exp(each.astype(np.float64)) for each in (prior.log_albedo, log_albedo)
        )
        channels = np.log(target / solution)
        scale = float(channels.mean())
        white_balance = np.asarray(channels - channels.mean(), np.float32)
    else:
        largest = log_albedo[lighting.known].max(axis=1)
        scale = float(np.log(lighting.brightest_albedo) - np.quantile(largest, settings.quantile))
    albedo = np.asarray(scale + white_balance)
    if evidence.exposure_prior.free:
        return Gain(albedo, scale, white_balance)
    return Gain(albedo, 0.0, albedo)


def with_gain(lighting: Lighting, log_albedo: np.ndarray, gain: Gain) -> Lighting:
    """The lighting with the gain, and with the albedo that it leads to; where that is not known, its median."""
    albedo = np.exp(log_albedo + gain.albedo)
    albedo[~lighting.known] = np.median(albedo[lighting.known], axis=0)
    lighting = replace(
        lighting, albedo=albedo, albedo_estimated=True, log_exposure=lighting.log_exposure - gain.exposure
    )
    if not gain.light.any():
        return lighting
    factor = np.exp(-gain.light)
    return replace(lighting, radiance=lighting.radiance * factor, bounce=lighting.bounce * factor)


def corrected_brightest(change: float, settings: AlbedoScaleSettings) -> float:
    """The brightest albedo after a `change` of the log scale that specular and bounced light ask for."""
    return float(np.clip(settings.brightest * np.exp(settings.correction * change), *settings.bounds))
