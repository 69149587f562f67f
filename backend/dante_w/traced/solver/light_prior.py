"""The light prior: a Gaussian process on the sphere for the log radiance of a light.

Log radiance is split into its mean over the channels (brightness) and the rest (colour). Two directions at an angle
theta have the covariance deviation^2 exp(-theta / length) + mean^2, where `mean` is the deviation of what all directions
share. So a light may vary strongly in brightness over short angles, and is nearly white. A sun, which is no part of the
sphere, is drawn nowhere: its log radiance is only kept from moving far in one step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LightPriorSettings:
    """Deviations are of the natural log of radiance, lengths in radians."""

    #: Deviation of brightness. A clear sky spans several stops.
    brightness: float = 2.0
    #: Correlation length of brightness: windows and lamps are narrow.
    brightness_length: float = 0.5
    #: Deviation of colour: most light is nearly white.
    colour: float = 0.15
    #: Correlation length of colour.
    colour_length: float = 0.8
    #: Deviation of the mean colour of a light.
    mean_colour: float = 0.1
    #: Deviation of the mean brightness where exposures are free: these then take up how bright a light is.
    mean_brightness: float = 0.1
    #: The same where exposures are known or one for all photos: then nothing else can take it up (`bench real`).
    open_mean_brightness: float = 10.0
    #: Deviation of a sun's log radiance from its value before the step.
    sun_step: float = 0.3
    #: Variance added to each direction, so that the covariance can be inverted.
    jitter: float = 1e-4


@dataclass(frozen=True)
class LightPrecision:
    """The prior's inverse covariances P_b and P_h of log radiance over D directions, suns last, float64.

    Attributes:
        brightness: (D, D) of the mean over the channels.
        colour: (D, D) of each channel's difference from that mean.
    """

    brightness: np.ndarray
    colour: np.ndarray

    def gradient(self, log_radiance: np.ndarray) -> np.ndarray:
        """(3, J, D) gradient of the prior's cost at the log radiance (J, D, 3) of J lights."""
        mean = log_radiance.mean(axis=2, keepdims=True)
        common = np.einsum("de,jex->xjd", self.brightness, mean)
        return np.asarray(common + np.einsum("de,jex->xjd", self.colour, log_radiance - mean))


def light_precision(
    directions: np.ndarray, suns: int, free_exposures: bool, settings: LightPriorSettings
) -> LightPrecision:
    """The prior of lights with these unit directions (D, 3), of which the last `suns` are suns.

    Args:
        free_exposures: whether exposures take up the mean brightness of the lights.
    """
    sphere = directions[: len(directions) - suns]
    angle = np.arccos(np.clip(sphere @ sphere.T, -1.0, 1.0)).astype(np.float64)

    def inverse(deviation: float, length: float, mean: float) -> np.ndarray:
        covariance = deviation**2 * np.exp(-angle / length) + mean**2 + settings.jitter * np.eye(len(angle))
        padded = np.pad(np.linalg.inv(covariance), (0, suns))
        return padded + np.diag(np.r_[np.zeros(len(sphere)), np.full(suns, settings.sun_step**-2)])

    mean = settings.mean_brightness if free_exposures else settings.open_mean_brightness
    return LightPrecision(
        inverse(settings.brightness, settings.brightness_length, mean),
        inverse(settings.colour, settings.colour_length, settings.mean_colour),
    )
