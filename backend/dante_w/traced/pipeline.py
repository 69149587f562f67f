"""From the ray cache to an albedo texture by traced light, with no network and no need of priors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dante_w.contract.scene_folder import Frame
from dante_w.contract.vocabulary import COMPONENTS
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.progress import Progress
from dante_w.scene.exposure import relative_log_exposures
from dante_w.scene.held_out import choose_held_out
from dante_w.traced.albedo_prior import fuse_priors
from dante_w.traced.albedo_texture import albedo_texture
from dante_w.traced.held_out import place
from dante_w.traced.light_clusters import first_clusters
from dante_w.traced.light_transport import LightTransport, trace_light_transport, with_suns
from dante_w.traced.shading_points import Observations, ShadingPoints, gather, thinned
from dante_w.traced.solver.solve_lights import evidence, solve_lights
from dante_w.traced.state import AlbedoPrior, Components, Lighting
from dante_w.traced.sun import find_and_add_suns


@dataclass(frozen=True)
class TracedScene:
    """What the photos show of the mesh's shading points, and how light reaches these; `groups` (K,) is the first guess of
    which photos share a light."""

    cameras: np.ndarray
    points: ShadingPoints
    seen: Observations
    transfer: LightTransport
    prior: AlbedoPrior | None
    exposures: np.ndarray | None
    groups: np.ndarray


@dataclass(frozen=True)
class SolvedLighting:
    """The lights of all photos, directions of `suns` (S, 3), and the held-out photos' PSNR in dB under them, if it could be
    taken."""

    lights: Lighting
    suns: np.ndarray
    score: float | None


def examine(
    cache: RayCache,
    scene3d: Scene3D,
    frames: list[Frame],
    directions: int,
    prior_weight: float,
    progress: Progress,
    finer: int = 1,
) -> TracedScene:
    """Average the photos over shading points, `finer` times as many along either side of the texture, and trace light between
    them."""
    cameras = scene3d.frame.normalise(np.stack([frame.camera_to_world[:3, 3] for frame in frames]))
    progress.update("transfer", 0.0, 1.0)
    points, seen = gather(cache, cameras, finer=finer)
    transfer = trace_light_transport(
        points,
        scene3d.caster,
        cache.surface.uvs.numpy(),
        directions,
        lambda done: progress.update("transfer", done, 1.0),
    )
    prior = fuse_priors(cache, points, prior_weight) if prior_weight > 0.0 else None
    exposures = relative_log_exposures(frames)
    groups = first_clusters(seen, len(points), len(frames))
    seen = seen.of(
        thinned(seen.point, seen.photo)
    )  # from here on, photos need not be compared with each other
    return TracedScene(cameras, points, seen, transfer, prior, exposures, groups)


def recover_albedo(
    of: TracedScene,
    cache: RayCache,
    scene3d: Scene3D,
    size: int,
    parts: Components,
    begun: Lighting | None,
    seed: int,
    progress: Progress,
    kept: Checkpoints | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The albedo (size, size, 3), float32 and linear, and facts for the report.

    Lights are solved without the held-out photos, going on from what the plan has `begun` if that is given; held-out photos
    then get the light and exposure that fit them best, and give their colour to the texture like all others.
    """
    assert cache.footprint is not None
    photos = len(of.cameras)
    progress.update("lights", 0.0, 1.0)
    held_out = choose_held_out(photos)

    caster = scene3d.caster if parts.sun else None

    def solve() -> SolvedLighting:
        shown = of.seen.of(~np.isin(of.seen.photo, held_out))
        lights = solve_lights(
            of.points,
            of.transfer,
            shown,
            of.cameras,
            of.groups,
            seed,
            lambda step, steps: progress.update("lights", step, steps),
            parts,
            of.prior,
            of.exposures,
            begun,
        )
        transfer = of.transfer
        if caster:
            transfer, lights = find_and_add_suns(
                evidence(of.points, shown, of.cameras, parts, of.prior, of.exposures),
                transfer,
                lights,
                caster,
                seed,
            )
        found, score = place(lights, of.points, transfer, of.seen, of.cameras, held_out, parts)
        return SolvedLighting(found, transfer.directions[transfer.parts :], score)

    placed = kept.done("lights", SolvedLighting, solve) if kept else solve()
    lights = placed.lights
    transfer = with_suns(of.transfer, of.points, caster, placed.suns) if caster else of.transfer
    texture = albedo_texture(
        cache,
        cache.footprint,
        of.points,
        transfer,
        lights,
        of.cameras,
        size,
        lambda done: progress.update("albedo", done, 1.0),
        of.seen,
        caster,
        parts.specular,
    )
    return texture, {
        "parts": {each.key: getattr(parts, each.name) for each in COMPONENTS},
        "lights": [int(light) for light in lights.cluster],
        "suns": _suns(transfer, lights),
        "shading_points": len(of.points),
        "held_out_psnr": placed.score,
        "setbacks": {"lights": [asdict(each) for each in lights.setbacks]},
    }


def _suns(transfer: LightTransport, lights: Lighting) -> list[dict[str, Any]]:
    """For the report: which light each sun belongs to, and where it stands in the scene's axes."""
    radiance = lights.radiance[:, transfer.parts :].mean(axis=2)
    return [
        {"light": int(radiance[:, number].argmax()), "direction": [round(float(x), 4) for x in direction]}
        for number, direction in enumerate(transfer.directions[transfer.parts :])
    ]
