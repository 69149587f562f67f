"""From the ray cache to an albedo texture by traced light, with no network and no need of priors."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from dante_w.contract.scene_folder import Frame
from dante_w.contract.vocabulary import COMPONENTS, LIGHT_TRANSPORT
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.progress import Progress
from dante_w.scene.exposure import relative_log_exposures
from dante_w.scene.held_out import choose_held_out
from dante_w.traced.albedo_prior import fuse_priors
from dante_w.traced.albedo_texture import albedo_texture
from dante_w.traced.held_out import fit_held_out
from dante_w.traced.light_clusters import first_clusters
from dante_w.traced.light_transport import LightTransport, trace_light_transport, with_suns
from dante_w.traced.observations import thinned
from dante_w.traced.settings import TracedSettings
from dante_w.traced.shading_points import gather
from dante_w.traced.solver.evidence import gather_evidence
from dante_w.traced.solver.solve_lights import solve_lights
from dante_w.traced.state import Components, Lighting, TracedScene
from dante_w.traced.sun import find_and_add_suns


@dataclass(frozen=True)
class SolvedLighting:
    """The lights of all photos, directions of `suns` (S, 3), and the held-out photos' PSNR in dB under them, if it could be
    taken."""

    lighting: Lighting
    suns: np.ndarray
    score: float | None


def trace_scene(
    cache: RayCache,
    scene3d: Scene3D,
    frames: list[Frame],
    settings: TracedSettings,
    prior_weight: float,
    progress: Progress,
) -> TracedScene:
    """Average the photos over shading points, and trace light between them."""
    cameras = scene3d.frame.normalise(np.stack([frame.camera_to_world[:3, 3] for frame in frames]))
    progress.update(LIGHT_TRANSPORT, 0.0, 1.0)
    points, observations = gather(cache, cameras, settings.shading)
    transport = trace_light_transport(
        points,
        scene3d.caster,
        cache.surface.uvs.numpy(),
        settings.directions,
        lambda done: progress.update(LIGHT_TRANSPORT, done, 1.0),
        settings.transport,
    )
    prior = fuse_priors(cache, points, prior_weight, settings.prior) if prior_weight > 0.0 else None
    exposures = relative_log_exposures(frames)
    clusters = first_clusters(observations, len(points), len(frames), settings.clusters)
    # from here on, photos need not be compared with each other
    keep = thinned(observations.point, observations.photo, settings=settings.shading.thinning)
    return TracedScene(cameras, points, observations.take(keep), transport, prior, exposures, clusters)


@dataclass(frozen=True)
class Recovery:
    """What is asked of the texture: `size` texels along a side, the `components` that are modelled, the lighting to go on from,
    if any, and the `seed`."""

    size: int
    components: Components
    start: Lighting | None
    seed: int


def recover_albedo(
    scene: TracedScene,
    cache: RayCache,
    scene3d: Scene3D,
    wanted: Recovery,
    settings: TracedSettings,
    progress: Progress,
    checkpoints: Checkpoints | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The albedo (size, size, 3), float32 and linear, and facts for the report.

    Lights are solved without the held-out photos; held-out photos then get the light and exposure that fit them best, and give
    their colour to the texture like all others.
    """
    progress.update("lights", 0.0, 1.0)
    components = wanted.components
    caster = scene3d.caster if components.sun else None

    def solve() -> SolvedLighting:
        held_out = choose_held_out(len(scene.cameras))
        shown = scene.observations.take(~np.isin(scene.observations.photo, held_out))
        solver = settings.solver
        evidence = gather_evidence(
            scene.points, shown, scene.cameras, solver.evidence, components, scene.prior, scene.exposures
        )
        lighting = solve_lights(
            evidence,
            scene.transport,
            scene.clusters if wanted.start is None else wanted.start,
            solver,
            wanted.seed,
            lambda step, steps: progress.update("lights", step, steps),
        )
        transport = scene.transport
        if caster:
            transport, lighting = find_and_add_suns(
                evidence, transport, lighting, caster, wanted.seed, solver, settings.sun
            )
        sunny = replace(scene, transport=transport)
        fitted, score = fit_held_out(lighting, sunny, held_out, components, settings.selection.held_out)
        return SolvedLighting(fitted, transport.directions[transport.parts :], score)

    solved = checkpoints.done("lights", SolvedLighting, solve) if checkpoints else solve()
    lighting = solved.lighting
    if caster:
        transport = with_suns(scene.transport, scene.points, caster, solved.suns, settings.transport)
        scene = replace(scene, transport=transport)
    making = settings.albedo if components.specular else replace(settings.albedo, specular=None)
    texture = albedo_texture(
        cache,
        scene,
        lighting,
        wanted.size,
        lambda done: progress.update("albedo", done, 1.0),
        caster,
        making,
    )
    return texture, {
        "parts": {each.key: getattr(components, each.name) for each in COMPONENTS},
        "lights": [int(cluster) for cluster in lighting.cluster],
        "suns": _suns(scene.transport, lighting),
        "shading_points": len(scene.points),
        "held_out_psnr": solved.score,
        "setbacks": {"lights": [asdict(each) for each in lighting.setbacks]},
    }


def _suns(transport: LightTransport, lighting: Lighting) -> list[dict[str, Any]]:
    """For the report: which light each sun belongs to, and where it stands in the scene's axes."""
    radiance = lighting.radiance[:, transport.parts :].mean(axis=2)
    return [
        {"light": int(radiance[:, number].argmax()), "direction": [round(float(x), 4) for x in direction]}
        for number, direction in enumerate(transport.directions[transport.parts :])
    ]
