"""How well photos that the lights were not solved from are re-rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dante_w.core.color import srgb_from_linear_array
from dante_w.traced.observations import Observations
from dante_w.traced.specular import USUAL_SPECULAR, SpecularSettings, specular_radiance
from dante_w.traced.state import FAINTEST, Components, Lighting, TracedScene


@dataclass(frozen=True)
class HeldOutSettings:
    """How held-out photos are scored.

    Attributes:
        band: rows of shading cells that take turns in fitting and scoring.
        outlier: absolute log residuals count no more than this when a photo chooses its light; twice the solver's.
        specular: the reflections that are modelled, where they are.
    """

    band: int = 8
    outlier: float = 0.3
    specular: SpecularSettings = USUAL_SPECULAR


USUAL_HELD_OUT = HeldOutSettings()


def fit_held_out(
    lighting: Lighting,
    scene: TracedScene,
    photos: np.ndarray,
    components: Components,
    settings: HeldOutSettings = USUAL_HELD_OUT,
) -> tuple[Lighting, float | None]:
    """Give each of `photos` the light and exposure that fit it best; returns the lighting with these, and the PSNR.

    A photo's own light and exposure are fitted on one half of what it shows, in bands of the texture; PSNR in dB of
    sRGB colours, a shading point's mean each, is taken on the other half. The mean of the photos' own PSNR counts: summed
    squares would be those of the photo that fares worst. None if nothing is left to score.

    Args:
        scene: its observations are what all photos show, its light transport has the suns that `lighting` has.
    """
    points, observations = scene.points, scene.observations
    cluster, exposure = lighting.cluster.copy(), lighting.log_exposure.copy()
    cell = np.flatnonzero(points.point_of_cell >= 0)
    level = observations.levels(len(cluster))
    even_band = (cell // points.side // settings.band) % 2 == 0
    diffuse = lighting.albedo[:, None] * lighting.irradiance(scene.transport)
    ends = np.searchsorted(observations.photo, np.arange(len(cluster) + 1))
    scores: list[float] = []
    for photo in photos:
        rows = np.arange(ends[photo], ends[photo + 1])
        usable = lighting.known[observations.point[rows]] & ~observations.clipped[rows]
        shown = observations.take(rows[usable])
        fitted = even_band[shown.point]
        if not fitted.any():
            continue
        rendered = diffuse[shown.point]
        if components.specular:
            rendered = rendered + _specular(lighting, scene, shown, photo, settings.specular)
        log_shown = np.log(np.maximum(shown.colour, FAINTEST))
        residual = log_shown[:, None] - np.log(np.maximum(rendered, FAINTEST))
        gain = (
            np.median(residual[fitted], axis=(0, 2))
            if components.exposures
            else np.full(rendered.shape[1], level[photo] + np.median(lighting.log_exposure - level))
        )
        bounded = np.minimum(np.abs(residual[fitted] - gain[:, None]), settings.outlier)
        cluster[photo] = int(bounded.mean(axis=(0, 2)).argmin())
        exposure[photo] = gain[cluster[photo]]
        predicted = np.exp(exposure[photo]) * rendered[~fitted, cluster[photo]]
        wanted = shown.colour[~fitted]
        error = np.subtract(
            *(srgb_from_linear_array(np.clip(each, 0.0, 1.0)) for each in (predicted, wanted))
        )
        if error.size:
            scores.append(-10.0 * np.log10(max(np.square(error, dtype=np.float64).mean(), 1e-12)))
    score = float(np.mean(scores)) if scores else None
    return replace(lighting, cluster=cluster, log_exposure=exposure), score


def _specular(
    lighting: Lighting, scene: TracedScene, shown: Observations, photo: int, settings: SpecularSettings
) -> np.ndarray:
    """(N, J, 3) specular part of one photo's rows under each light, at an exposure of 1."""
    count, lights = len(shown.point), len(lighting.radiance)
    towards = scene.points.towards(shown.point, scene.cameras[photo])
    specular = specular_radiance(
        np.tile(shown.point, lights),
        np.repeat(np.arange(lights), count),
        np.tile(towards, (lights, 1)),
        scene.points.normal,
        scene.transport,
        lighting.radiance,
        settings,
    )
    return specular.reshape(lights, count, 3).transpose(1, 0, 2)
