"""The state of traced light: what is modelled, what is known beforehand, and the lighting that is solved for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dante_w.run.setbacks import Setback
from dante_w.traced.light_transport import LightTransport
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import ShadingPoints

#: No colour, irradiance or albedo is taken to be less (linear).
FAINTEST = 1e-5


@dataclass(frozen=True)
class Components:
    """Which parts of the light are modelled: `clusters`, several lights that photos share; `exposures`, one for each photo;
    `bounce`, light that the mesh reflects onto itself; `specular` reflections; `sun`, lights too small for the directions."""

    clusters: bool = True
    exposures: bool = True
    bounce: bool = True
    specular: bool = True
    sun: bool = True


ALL_COMPONENTS = Components()


@dataclass(frozen=True)
class AlbedoPrior:
    """What is known of the points beforehand: natural log of linear albedo, `log_albedo` (C, 3), with the `weight` (C,) of
    so many photos."""

    log_albedo: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Lighting:
    """The state of the solve, linear Rec.709. J lights, D directions, K photos, C shading points.

    Attributes:
        radiance: (J, D, 3) of each light by direction, > 0, relative: a photo with log exposure 0 shows an open point of
            albedo a under radiance 1 from everywhere as a.
        cluster: (K,) the light of each photo.
        log_exposure: (K,) natural log of what a photo's colours are multiplied with: positive is brighter.
        bounce: (C, J, 3) irradiance that arrives from the mesh itself, in the unit of `radiance`.
        albedo: (C, 3) of the points, in [0, 1] but for errors.
        known: (C,) bool, where albedo follows from the photos; elsewhere it is their median.
        brightest_albedo: what the brightest albedo is taken to be where no prior gives the scale, see `albedo_scale`.
        albedo_estimated: whether `albedo` is an estimate; before the first step it is all zero.
        setbacks: steps that were rejected.
    """

    radiance: np.ndarray
    cluster: np.ndarray
    log_exposure: np.ndarray
    bounce: np.ndarray
    albedo: np.ndarray
    known: np.ndarray
    brightest_albedo: float
    albedo_estimated: bool = True
    setbacks: tuple[Setback, ...] = ()

    def irradiance(self, transport: LightTransport) -> np.ndarray:
        """(C, J, 3) at the points."""
        direct = np.tensordot(transport.direct, self.radiance, axes=(1, 1))
        return np.maximum(direct + self.bounce, np.float32(FAINTEST))


@dataclass(frozen=True)
class TracedScene:
    """What the photos show of the mesh's shading points, and how light reaches these.

    Attributes:
        cameras: (K, 3) the photos' centres in the unit cube.
        points: the shading points.
        observations: what all photos show of them.
        transport: how light reaches them.
        prior: what is known of their albedo beforehand.
        exposures: (K,) natural log of the photos' exposures where all their files name one (EXIF).
        clusters: (K,) a first guess of which photos share a light, rather too many lights than too few.
    """

    cameras: np.ndarray
    points: ShadingPoints
    observations: Observations
    transport: LightTransport
    prior: AlbedoPrior | None
    exposures: np.ndarray | None
    clusters: np.ndarray
