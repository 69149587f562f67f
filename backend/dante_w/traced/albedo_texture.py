"""The albedo texture from every pixel of the photos, once their lights are known.

Each pixel's colour, less its specular reflection, is divided by the irradiance at its surface point; the texture is the weighted
mean. Irradiance is taken with the pixel's own normal and the visibility of its shading point, or of its own where a sun shines.
How far pixels are trusted, `pixel_weights` says: each photo's mean colours over shading points are held against those of the
others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import prange

from dante_w.core.color import linear_from_srgb_array
from dante_w.core.jit import njit_parallel
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.raycast import Raycaster
from dante_w.texture.photo_average import PhotoAverage
from dante_w.traced.light_transport import USUAL_TRANSPORT, LightTransport, TransportSettings, sun_visibility
from dante_w.traced.observations import Observations
from dante_w.traced.pixel_weights import (
    USUAL,
    Consensus,
    PixelWeightSettings,
    clipped_weight,
    consensus,
    consensus_weight,
    dark_weight,
    edge_weight,
)
from dante_w.traced.sample_geometry import locate_samples, shading_normals
from dante_w.traced.shading_points import view
from dante_w.traced.specular import USUAL_SPECULAR, SpecularSettings, specular_radiance
from dante_w.traced.state import Lighting, TracedScene


@dataclass(frozen=True)
class AlbedoSettings:
    """How pixels become albedo.

    Attributes:
        highest: albedo is physically below 1; noise in the dark is not.
        darkest: no linear colour or irradiance is taken to be less when one is divided by the other.
        other_face: the light of a point says nothing of a pixel whose face turns from it by this cosine or less: that is the
            other side.
        least_diffuse: at least this share of a colour is taken to be diffuse, for its logarithm.
        noise: absolute error of a photo's linear values.
        weights: how far pixels are trusted.
        specular: the reflections that are taken off; None where the lights were solved without.
        transport: how a sun's shadows are traced.
    """

    highest: float = 2.0
    darkest: float = 1e-4
    other_face: float = -0.5
    least_diffuse: float = 0.1
    noise: float = 0.004
    weights: PixelWeightSettings = USUAL
    specular: SpecularSettings | None = USUAL_SPECULAR
    transport: TransportSettings = USUAL_TRANSPORT


USUAL_ALBEDO = AlbedoSettings()


def albedo_texture(
    cache: RayCache,
    scene: TracedScene,
    lighting: Lighting,
    size: int,
    progress: Callable[[float], None],
    caster: Raycaster | None = None,
    settings: AlbedoSettings = USUAL_ALBEDO,
) -> np.ndarray:
    """(size, size, 3) float32 linear albedo; texels between photos' pixels are filled.

    Args:
        cache: with the samples' footprints.
        scene: its light transport has the suns that `lighting` has.
        caster: of the mesh, for the edges of suns' shadows; needed where there are suns.
    """
    assert cache.footprint is not None
    mean = PhotoAverage(size, size)
    points, transport, weights = scene.points, scene.transport, settings.weights
    photos = len(cache.starts) - 1
    irradiance_at_points = lighting.irradiance(transport)
    exposed = np.bincount(scene.observations.point, ~scene.observations.clipped, len(points)) > 0
    expected = _consensus(scene, lighting, irradiance_at_points, settings)
    for photo in range(photos):
        part = slice(cache.starts[photo], cache.starts[photo + 1])
        face, uv, place = locate_samples(cache, part)
        point, cluster = points.at(uv), lighting.cluster[photo]
        shown, row = view(cache, points, photo, point, weights)
        specular = _specular(shown, scene, lighting, settings)
        bary = np.asarray(cache.bary[part])
        normal = shading_normals(cache.surface, face, bary, place, scene.cameras[photo])
        surface = Surface(point, place, normal)
        irradiance = direct_irradiance(surface, transport, lighting.radiance[cluster], caster, settings)
        irradiance += lighting.bounce[point, cluster]
        srgb = np.asarray(cache.colour[part], np.float32)
        colour = linear_from_srgb_array(srgb)
        gain = np.float32(np.exp(lighting.log_exposure[photo]))
        weight = np.where((normal * points.normal[point]).sum(axis=1) > settings.other_face, 1.0, 0.0)
        log_albedo, noise = _log_albedo(shown, lighting, irradiance_at_points, specular, settings)
        weight = weight * consensus_weight(log_albedo, noise, shown.point, expected, weights)[row]
        weight = weight * clipped_weight(srgb, exposed[point], weights)
        weight = weight * dark_weight(colour.mean(axis=1), weights)
        if cache.edge is not None:
            weight = weight * edge_weight(np.asarray(cache.edge[part]), weights)
        diffuse = (
            colour / gain - specular[row]
        )  # below 0 here and there: so the mean of dark surfaces is right
        bright = np.maximum(irradiance, settings.darkest)
        albedo = np.clip(diffuse / bright, -settings.highest, settings.highest)
        mean.add(uv, albedo, weight, cache.footprint[part] * size)
        cache.forget()
        progress((photo + 1) / photos)
    return np.maximum(mean.resolve(), 0.0)


def _consensus(
    scene: TracedScene, lighting: Lighting, irradiance: np.ndarray, settings: AlbedoSettings
) -> Consensus:
    """What most photos show of each point, under `irradiance` (C, J, 3)."""
    observations, weights = scene.observations, settings.weights
    specular = _specular(observations, scene, lighting, settings)
    log_albedo, noise = _log_albedo(observations, lighting, irradiance, specular, settings)
    exposed = np.where(observations.clipped, weights.clipped_opinion, 1.0)
    weight = exposed / (1.0 + np.square(noise / weights.agreement))
    cluster = lighting.cluster[observations.photo]
    return consensus(log_albedo, weight, observations.point, cluster, weights)


def _specular(
    observations: Observations, scene: TracedScene, lighting: Lighting, settings: AlbedoSettings
) -> np.ndarray:
    """(M, 3) what the observations owe to specular reflection, at an exposure of 1."""
    if settings.specular is None:
        return np.zeros_like(observations.colour)
    towards = scene.points.towards(observations.point, scene.cameras[observations.photo])
    return specular_radiance(
        observations.point,
        lighting.cluster[observations.photo],
        towards,
        scene.points.normal,
        scene.transport,
        lighting.radiance,
        settings.specular,
    )


def _log_albedo(
    observations: Observations,
    lighting: Lighting,
    irradiance: np.ndarray,
    specular: np.ndarray,
    settings: AlbedoSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) log albedo by each observation under `irradiance` (C, J, 3), and (M,) its standard deviation by noise."""
    gain = np.exp(lighting.log_exposure[observations.photo, None]).astype(np.float32)
    shown = observations.colour / gain
    diffuse = np.maximum(np.maximum(shown - specular, settings.least_diffuse * shown), settings.darkest)
    noise = settings.noise / np.maximum(observations.colour.mean(axis=1), settings.darkest)
    return np.log(diffuse / irradiance[observations.point, lighting.cluster[observations.photo]]), noise


@dataclass(frozen=True)
class Surface:
    """N pixels' surface: `point` (N,) the shading point of each, `place` (N, 3) in the unit cube, unit `normal` (N, 3)."""

    point: np.ndarray
    place: np.ndarray
    normal: np.ndarray


def direct_irradiance(
    surface: Surface,
    transport: LightTransport,
    radiance: np.ndarray,
    caster: Raycaster | None,
    settings: AlbedoSettings = USUAL_ALBEDO,
) -> np.ndarray:
    """(N, 3) direct light of `radiance` (D, 3) on pixels: the sphere's as their shading points see it, a sun's by
    rays of their own."""
    out = np.zeros((len(surface.point), 3), np.float32)
    parts = transport.parts
    directions, visible = transport.directions[:parts], transport.visible
    _add_irradiance(surface.point, surface.normal, directions, visible, radiance[:parts], out)
    for sun, strength in zip(transport.directions[parts:], radiance[parts:], strict=True):
        if caster and strength.max() > settings.darkest:
            shadow = sun_visibility(surface.place, surface.normal, caster, sun, settings.transport)
            lit = np.maximum(surface.normal @ sun, 0.0) * shadow
            out += np.float32(transport.share) * lit[:, None] * strength
    return out


@njit_parallel
def _add_irradiance(
    point: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add to `out` (N, 3) what `directions` (D, 3) of `radiance` (D, 3) bring to pixels with `normals` (N, 3), as far as their
    shading points `point` (N,) see them, `visible` (C, D)."""
    share = np.float32(4.0 / len(directions))
    for m in prange(len(point)):
        n, c = normals[m], point[m]
        for d in range(len(directions)):
            cosine = n[0] * directions[d, 0] + n[1] * directions[d, 1] + n[2] * directions[d, 2]
            amount = share * cosine * visible[c, d]
            if amount > 0.0:
                for channel in range(3):
                    out[m, channel] += amount * radiance[d, channel]
