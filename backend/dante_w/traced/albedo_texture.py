"""The albedo texture from every pixel of the photos, once their lights are known.

Each pixel's colour, less its sheen, is divided by the irradiance at its surface point; the texture is the weighted mean.
Irradiance is taken with the pixel's own normal and the visibility of its shading point,
or of its own where a sun shines. How far pixels are trusted,
`robust` says: each photo's mean colours over shading points are held against those of the others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import prange

from dante_w.core.color import linear_from_srgb_array
from dante_w.core.jit import njit_parallel
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.raycast import Raycaster
from dante_w.texture.photo_average import PhotoAverage
from dante_w.traced import pixel_weights as robust
from dante_w.traced.light_transport import LightTransport, sunlit
from dante_w.traced.shading_points import Observations, ShadingPoints, facing, located, view
from dante_w.traced.solver.solve_lights import ABSOLUTE
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import Lighting

#: Albedo is physically below 1; noise in the dark is not.
HIGHEST = 2.0
DARKEST = 1e-4
#: The light of a point says nothing of a pixel whose face turns from it by this cosine or less: that is the other side.
OTHER_FACE = -0.5
#: What is shown is taken to be diffuse by this share at least, for its logarithm.
LEAST_DIFFUSE = 0.1


def albedo_texture(
    cache: RayCache,
    footprints: np.ndarray,
    points: ShadingPoints,
    transfer: LightTransport,
    lights: Lighting,
    cameras: np.ndarray,
    size: int,
    progress: Callable[[float], None],
    seen: Observations,
    caster: Raycaster | None = None,
    glossy: bool = True,
    weights: robust.Weights = robust.ALL,
) -> np.ndarray:
    """(size, size, 3) float32 linear albedo; texels between photos' pixels are filled.

    Args:
        footprints: (N,) of the cache's samples, as fractions of the texture's side.
        seen: what all photos show of the points, as `gather` has it.
        caster: of the mesh, for the edges of suns' shadows; needed where the transfer has suns.
        glossy: whether the lights were solved with sheen.
    """
    mean = PhotoAverage(size, size)
    photos = len(cache.starts) - 1
    lit = lights.irradiance(transfer)
    told = np.bincount(seen.point, ~seen.clipped, len(points)) > 0
    most = robust.consensus(*_opinions(seen, points, transfer, lights, lit, cameras, glossy))
    for photo in range(photos):
        part = slice(cache.starts[photo], cache.starts[photo + 1])
        face, uv, place = located(cache, part)
        point, light = points.at(uv), lights.cluster[photo]
        own, row = view(cache, points, photo, point, weights)
        gloss = _specular_radiance(own, points, transfer, lights, cameras, glossy)
        normal = facing(cache.surface, face, np.asarray(cache.bary[part]), place, cameras[photo])
        irradiance = irradiance_of(point, place, normal, transfer, lights.radiance[light], caster)
        irradiance += lights.bounce[point, light]
        srgb = np.asarray(cache.colour[part], np.float32)
        colour = linear_from_srgb_array(srgb)
        gain = np.float32(np.exp(lights.log_exposure[photo]))
        weight = np.where((normal * points.normal[point]).sum(axis=1) > OTHER_FACE, 1.0, 0.0)
        if weights.outlier:
            log_albedo, noise = _log_albedo(own, lights, lit, gloss)
            weight = weight * robust.agreement(log_albedo, noise, own.point, most)[row]
        if weights.clipped:
            weight = weight * robust.clipped(srgb, told[point])
        if weights.dark:
            weight = weight * robust.dark(colour.mean(axis=1))
        if weights.edge and cache.edge is not None:
            weight = weight * robust.edge(np.asarray(cache.edge[part]))
        diffuse = colour / gain - gloss[row]  # below 0 here and there: so the mean of dark surfaces is right
        albedo = np.clip(diffuse / np.maximum(irradiance, DARKEST), -HIGHEST, HIGHEST)
        mean.add(uv, albedo, weight, footprints[part] * size)
        cache.forget()
        progress((photo + 1) / photos)
    return np.maximum(mean.resolve(), 0.0)


def _opinions(
    seen: Observations,
    points: ShadingPoints,
    transfer: LightTransport,
    lights: Lighting,
    lit: np.ndarray,
    cameras: np.ndarray,
    glossy: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the observations say of log albedo (M, 3), how much each counts (M,), its point and its light (M,)."""
    log_albedo, noise = _log_albedo(
        seen, lights, lit, _specular_radiance(seen, points, transfer, lights, cameras, glossy)
    )
    weight = np.where(seen.clipped, 0.02, 1.0) / (1.0 + np.square(noise / robust.AGREED))
    return log_albedo, weight, seen.point, lights.cluster[seen.photo]


def _specular_radiance(
    seen: Observations,
    points: ShadingPoints,
    transfer: LightTransport,
    lights: Lighting,
    cameras: np.ndarray,
    glossy: bool,
) -> np.ndarray:
    """(M, 3) what the observations owe to gloss, before exposure."""
    if not glossy:
        return np.zeros_like(seen.colour)
    towards = points.towards(seen.point, cameras[seen.photo])
    light = lights.cluster[seen.photo]
    return specular_radiance(
        seen.point,
        light,
        towards,
        points.normal,
        transfer.directions,
        transfer.visible,
        lights.radiance,
        transfer.suns,
    )


def _log_albedo(
    seen: Observations, lights: Lighting, lit: np.ndarray, gloss: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(M, 3) log albedo by each observation under irradiance `lit` (C, J, 3), and (M,) its standard deviation by noise."""
    shown = seen.colour / np.exp(lights.log_exposure[seen.photo, None]).astype(np.float32)
    diffuse = np.maximum(np.maximum(shown - gloss, LEAST_DIFFUSE * shown), DARKEST)
    noise = ABSOLUTE / np.maximum(seen.colour.mean(axis=1), DARKEST)
    return np.log(diffuse / lit[seen.point, lights.cluster[seen.photo]]), noise


def irradiance_of(
    point: np.ndarray,
    place: np.ndarray,
    normals: np.ndarray,
    transfer: LightTransport,
    radiance: np.ndarray,
    caster: Raycaster | None,
) -> np.ndarray:
    """(N, 3) direct light of `radiance` (D, 3) on pixels (N, 3): the sphere's as their shading points see it, a sun's by
    rays of their own."""
    out = np.zeros((len(point), 3), np.float32)
    parts = transfer.parts
    _sum_light(point, normals, transfer.directions[:parts], transfer.visible, radiance[:parts], out)
    for sun, strength in zip(transfer.directions[parts:], radiance[parts:], strict=True):
        if caster and strength.max() > DARKEST:
            seen = np.maximum(normals @ sun, 0.0) * sunlit(place, normals, caster, sun)
            out += np.float32(transfer.share) * seen[:, None] * strength
    return out


@njit_parallel
def _sum_light(
    point: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
    out: np.ndarray,
) -> None:
    share = np.float32(4.0 / len(directions))
    for m in prange(len(point)):
        n, c = normals[m], point[m]
        for d in range(len(directions)):
            cosine = n[0] * directions[d, 0] + n[1] * directions[d, 1] + n[2] * directions[d, 2]
            amount = share * cosine * visible[c, d]
            if amount > 0.0:
                for channel in range(3):
                    out[m, channel] += amount * radiance[d, channel]
