"""How well photos that the lights were not solved from are re-rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dante_w.core.color import srgb_from_linear_array
from dante_w.traced.light_transport import LightTransport
from dante_w.traced.shading_points import Observations, ShadingPoints
from dante_w.traced.solver.variable_projection import OUTLIER
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import FAINTEST, Components, Lighting

#: Rows of cells that take turns in fitting and scoring.
BAND = 8


def place(
    lights: Lighting,
    points: ShadingPoints,
    transfer: LightTransport,
    seen: Observations,
    cameras: np.ndarray,
    photos: np.ndarray,
    parts: Components,
) -> tuple[Lighting, float | None]:
    """Give each of `photos` the light and exposure that fit it best; returns the lights with these, and the PSNR.

    A photo's own light and exposure are fitted on one half of what it shows, in bands of the texture; PSNR in dB of
    sRGB colours, a shading point's mean each, is taken on the other half. The mean of the photos' own PSNR counts: summed
    squares would be those of the photo that fares worst. None if nothing is left to score.

    Args:
        seen: what all photos show.
    """
    light, exposure = lights.cluster.copy(), lights.log_exposure.copy()
    cell = np.flatnonzero(points.point_of_cell >= 0)
    level = seen.levels(len(light))
    band = (cell // points.side // BAND) % 2 == 0
    told = lights.albedo[:, None] * lights.irradiance(transfer)
    ends = np.searchsorted(seen.photo, np.arange(len(light) + 1))
    scores: list[float] = []
    for photo in photos:
        own = np.arange(ends[photo], ends[photo + 1])
        rows = seen.of(own[lights.known[seen.point[own]] & ~seen.clipped[own]])
        fitted = band[rows.point]
        if not fitted.any():
            continue
        shown = told[rows.point] + _gloss(lights, points, transfer, rows, cameras[photo], parts)
        off = np.log(np.maximum(rows.colour, FAINTEST))[:, None] - np.log(np.maximum(shown, FAINTEST))
        gain = (
            np.median(off[fitted], axis=(0, 2))
            if parts.exposures
            else np.full(shown.shape[1], level[photo] + np.median(lights.log_exposure - level))
        )
        cost = np.minimum(np.abs(off[fitted] - gain[:, None]), 2.0 * OUTLIER).mean(axis=(0, 2))
        light[photo] = int(cost.argmin())
        exposure[photo] = gain[light[photo]]
        rendered = np.exp(exposure[photo]) * shown[~fitted, light[photo]]
        wanted = rows.colour[~fitted]
        error = np.subtract(*(srgb_from_linear_array(np.clip(each, 0.0, 1.0)) for each in (rendered, wanted)))
        if error.size:
            scores.append(-10.0 * np.log10(max(np.square(error, dtype=np.float64).mean(), 1e-12)))
    score = float(np.mean(scores)) if scores else None
    return replace(lights, cluster=light, log_exposure=exposure), score


def _gloss(
    lights: Lighting,
    points: ShadingPoints,
    transfer: LightTransport,
    rows: Observations,
    camera: np.ndarray,
    parts: Components,
) -> np.ndarray:
    """(N, J, 3) sheen of one photo's rows under each light, at an exposure of 1."""
    count, number = len(rows.point), len(lights.radiance)
    if not parts.specular:
        return np.zeros((count, number, 3), np.float32)
    gloss = specular_radiance(
        np.tile(rows.point, number),
        np.repeat(np.arange(number), count),
        np.tile(points.towards(rows.point, camera), (number, 1)),
        points.normal,
        transfer.directions,
        transfer.visible,
        lights.radiance,
        transfer.suns,
    )
    return gloss.reshape(number, count, 3).transpose(1, 0, 2)
