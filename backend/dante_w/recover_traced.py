"""Recovery by light traced through the mesh: lights first, then the albedo in closed form; and its plan."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dante_w.model.held_out import choose_held_out
from dante_w.model.presets import PRESETS
from dante_w.progress import Progress
from dante_w.rays.ray_cache import RayCache
from dante_w.scene.mesh import Mesh
from dante_w.scene.scene_folder import Scene
from dante_w.stages import bake_files, expect_no_fit, known_gain, nearest, prepare, trace_rays, write_report
from dante_w.texture.coverage import Coverage, empty_coverage, mark
from dante_w.traced.lights import Parts
from dante_w.traced.parts import Decision, choose_parts
from dante_w.traced.solve import Traced, examine, recover_albedo

#: Directions that light comes from: fewer lose the shadows' edges, more cost time (cubed) and tell no more.
DIRECTIONS = {"draft": 64, "standard": 256, "high": 256, "paper": 256}
#: For a plan alone.
FEW_DIRECTIONS = 64


def recover_traced(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Light traced through the mesh. Arguments and errors as `recover.recover`."""
    scene, mesh, cache, coverage, size = _surface(options, staging, progress)
    of, parts, plan = _plan(options, scene, mesh, cache, DIRECTIONS[options.preset], progress)
    texture, facts = recover_albedo(of, cache, size, parts, options.seed, progress)
    texels = nearest(texture)
    gain = known_gain(texels, coverage, options.known)
    seen = bake_files(nearest(texture * gain), mesh, coverage, options.format, staging, progress)
    return write_report(
        options,
        staging,
        progress,
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        plan=[asdict(decision) for decision in plan],
        coverage=seen,
        albedo_gain=[round(float(g), 4) for g in gain],
        held_out_photos=[scene.frames[i].image.name for i in choose_held_out(len(scene.frames))],
        texture_size=size,
        **facts,
    )


def plan(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide what to model and say so, without doing it. Arguments and errors as `recover.recover`."""
    scene, mesh, cache, _, size = _surface(options, staging, progress)
    decisions = _plan(options, scene, mesh, cache, FEW_DIRECTIONS, progress)[2]
    progress.close()
    return {"plan": [asdict(decision) for decision in decisions], "texture_size": size, "samples": len(cache)}


def _surface(
    options: argparse.Namespace, staging: Path, progress: Progress
) -> tuple[Scene, Mesh, RayCache, Coverage, int]:
    size = options.texture_size or PRESETS[options.preset].texture_size
    scene, mesh = prepare(options, options.priors, size, staging, progress)
    expect_no_fit(options, scene, mesh, size, staging, progress)
    coverage = empty_coverage(size, size)
    cache = trace_rays(
        scene, mesh, lambda uv, footprint, _: mark(coverage, uv, footprint * size), staging, progress
    )
    return scene, mesh, cache, coverage, size


def _plan(
    options: argparse.Namespace,
    scene: Scene,
    mesh: Mesh,
    cache: RayCache,
    directions: int,
    progress: Progress,
) -> tuple[Traced, Parts, list[Decision]]:
    of = examine(cache, mesh, scene.frames, directions, options.prior_weight, progress)
    progress.update("plan", 0.0, 1.0)
    fixed = dict.fromkeys(options.model, True) | dict.fromkeys(options.leave_out, False)
    parts, decisions = choose_parts(
        of.cameras,
        of.points,
        of.seen,
        of.transfer,
        of.exposures,
        of.groups,
        fixed,
        options.seed,
        lambda done, trials: progress.update("plan", done, trials),
    )
    progress.close()
    if options.json:
        progress.say({"stage": "planned", "decisions": [asdict(decision) for decision in decisions]})
    else:
        for line in decisions:
            print(f"{line.what}: {line.choice} ({line.reason}; {line.costs})", file=sys.stderr, flush=True)
    return of, parts, decisions
