"""The evidence that lights are solved from: weighted observations, and what is known of albedo and exposures beforehand."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dante_w.core.jit import njit
from dante_w.traced.light_transport import LightTransport
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.specular import SpecularSettings, specular_radiance
from dante_w.traced.state import ALL_COMPONENTS, FAINTEST, AlbedoPrior, Components, Lighting


@dataclass(frozen=True)
class ExposureSettings:
    """Standard deviations of log exposure (natural log) around what is expected."""

    #: Where nothing is known of exposures: photos vary by a stop or two.
    free: float = 1.0
    #: Where the photos' files tell shutter, aperture and ISO.
    known: float = 0.1
    #: Where all photos are taken to have one exposure.
    shared: float = 1e-3


@dataclass(frozen=True)
class EvidenceSettings:
    """Errors of the observations, from which their weights follow."""

    #: Relative error of a colour that the model makes anyway.
    relative_error: float = 0.04
    #: Error of a photo's linear values: noise and rounding.
    absolute_error: float = 0.004
    #: Pixels from which on an observation counts no more: those of one cell err alike.
    full_pixels: int = 4
    #: Linear colour below which an observation weighs no less.
    darkest: float = 1e-4
    exposure: ExposureSettings = field(default_factory=ExposureSettings)


@dataclass(frozen=True)
class ExposurePrior:
    """A Gaussian prior on log exposures, up to one value for all photos.

    Attributes:
        mean: (K,) expected natural log of exposure; positive is brighter.
        deviation: standard deviation around it.
        free: whether nothing is known of exposures. They then take up the scale that albedo gives away, else lights do.
    """

    mean: np.ndarray
    deviation: float
    free: bool


@dataclass(frozen=True)
class Evidence:
    """What lights are to explain: M observations of C points in K photos.

    Attributes:
        points: the shading points.
        observations: what the photos show of them, photo after photo.
        by_point: the rows sorted by point, see `rows_by_point`.
        log_colour: (M, 3) natural log of the linear colour.
        view: (M, 3) unit vectors from the points to the cameras.
        weight: (M, 3) how much an observation counts: 4 for a mid grey of many pixels, 0 where it is clipped.
        albedo_prior: what is known of the points' albedo; all weights are 0 if nothing is.
        exposure_prior: what is known of the photos' exposures.
        components: what is modelled.
    """

    points: ShadingPoints
    observations: Observations
    by_point: tuple[np.ndarray, np.ndarray]
    log_colour: np.ndarray
    view: np.ndarray
    weight: np.ndarray
    albedo_prior: AlbedoPrior
    exposure_prior: ExposurePrior
    components: Components


def gather_evidence(
    points: ShadingPoints,
    observations: Observations,
    cameras: np.ndarray,
    settings: EvidenceSettings,
    components: Components = ALL_COMPONENTS,
    albedo_prior: AlbedoPrior | None = None,
    known_exposure: np.ndarray | None = None,
) -> Evidence:
    """Weigh the observations and put them together with what is known.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
        albedo_prior: what is known of the albedo, if anything.
        known_exposure: (K,) natural log of exposure from the photos' files, if all tell it.
    """
    count, photos = len(points), len(cameras)
    no_prior = AlbedoPrior(np.zeros((count, 3), np.float32), np.zeros(count, np.float32))
    return Evidence(
        points,
        observations,
        rows_by_point(observations.point, count),
        np.log(np.maximum(observations.colour, FAINTEST)),
        points.towards(observations.point, cameras[observations.photo]),
        _weights(observations, settings),
        albedo_prior or no_prior,
        _exposure_prior(observations.levels(photos), components, known_exposure, settings.exposure),
        components,
    )


def _exposure_prior(
    applied: np.ndarray, components: Components, known: np.ndarray | None, settings: ExposureSettings
) -> ExposurePrior:
    """The prior of photos whose colours were multiplied by the exponential of `applied` (K,)."""
    if not components.exposures:
        return ExposurePrior(applied, settings.shared, free=False)
    if known is not None:
        return ExposurePrior(known + applied, settings.known, free=False)
    return ExposurePrior(np.zeros(len(applied)), settings.free, free=True)


def _weights(observations: Observations, settings: EvidenceSettings) -> np.ndarray:
    relative = settings.relative_error
    dark = (settings.absolute_error / np.maximum(observations.colour, settings.darkest)) ** 2
    pixels = np.minimum(observations.pixels, settings.full_pixels)
    weight = pixels[:, None] * relative**2 / (relative**2 + dark)
    return np.where(observations.clipped[:, None], 0.0, weight).astype(np.float32)


def observed_specular(
    evidence: Evidence, transport: LightTransport, lighting: Lighting, settings: SpecularSettings
) -> np.ndarray:
    """(M, 3) float32 specular radiance S of the observations, linear, before exposure."""
    return specular_radiance(
        evidence.observations.point,
        lighting.cluster[evidence.observations.photo],
        evidence.view,
        evidence.points.normal,
        transport,
        lighting.radiance,
        settings,
    )


@njit
def rows_by_point(point: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Row numbers (M,) sorted by their point (M,), each point's in ascending order; and (C + 1,) where each point's begin."""
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
