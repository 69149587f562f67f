"""Recovery by light traced through the mesh: lights first, then the albedo in closed form; and its plan."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dante_w.checkpoints import Checkpoints, open_checkpoints
from dante_w.model.held_out import choose_held_out
from dante_w.model.presets import PRESETS
from dante_w.progress import Progress
from dante_w.rays.ray_cache import RayCache
from dante_w.scene.mesh import Mesh
from dante_w.scene.scene_folder import Scene
from dante_w.stages import (
    bake_files,
    check_exposed,
    expect_no_fit,
    known_gain,
    look,
    nearest,
    prepare,
    write_report,
)
from dante_w.traced.lights import Parts
from dante_w.traced.parts import Decision, choose_parts
from dante_w.traced.solve import Traced, examine, recover_albedo

#: Directions that light comes from: fewer lose the shadows' edges, more cost time (cubed) and tell no more.
DIRECTIONS = {"draft": 64, "standard": 256, "high": 256, "paper": 256}
#: For a plan alone.
FEW_DIRECTIONS = 64


def recover_traced(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Light traced through the mesh. Arguments and errors as `recover.recover`."""
    size, scene, mesh = _start(options, staging, progress)
    kept = open_checkpoints(options, scene, mesh)
    seen = look(scene, mesh, size, kept, staging, progress)
    cache, coverage = seen.cache, seen.coverage
    check_exposed(scene, cache)
    of, parts, plan = _plan(options, scene, mesh, cache, DIRECTIONS[options.preset], progress, kept)
    texture, facts = recover_albedo(of, cache, size, parts, options.seed, progress, kept)
    texels = nearest(texture)
    gain = known_gain(texels, coverage, options.known)
    covered = bake_files(nearest(texture * gain), mesh, coverage, options.format, staging, progress)
    return write_report(
        options,
        staging,
        progress,
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        plan=[asdict(decision) for decision in plan],
        coverage=covered,
        resumed=kept.resumed,
        albedo_gain=[round(float(g), 4) for g in gain],
        held_out_photos=[scene.frames[i].image.name for i in choose_held_out(len(scene.frames))],
        texture_size=size,
        **facts,
    )


def plan(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide what to model and say so, without doing it. Arguments and errors as `recover.recover`."""
    size, scene, mesh = _start(options, staging, progress)
    cache = look(scene, mesh, size, None, staging, progress).cache
    check_exposed(scene, cache)
    decisions = _plan(options, scene, mesh, cache, FEW_DIRECTIONS, progress)[2]
    progress.close()
    return {"plan": [asdict(decision) for decision in decisions], "texture_size": size, "samples": len(cache)}


def _start(options: argparse.Namespace, staging: Path, progress: Progress) -> tuple[int, Scene, Mesh]:
    size = options.texture_size or PRESETS[options.preset].texture_size
    scene, mesh = prepare(options, options.priors, size, staging, progress)
    expect_no_fit(options, scene, mesh, size, staging, progress)
    return size, scene, mesh


@dataclass(frozen=True)
class _Planned:
    parts: Parts
    decisions: list[Decision]


def _plan(
    options: argparse.Namespace,
    scene: Scene,
    mesh: Mesh,
    cache: RayCache,
    directions: int,
    progress: Progress,
    kept: Checkpoints | None = None,
) -> tuple[Traced, Parts, list[Decision]]:
    def trace() -> Traced:
        return examine(cache, mesh, scene.frames, directions, options.prior_weight, progress)

    of = kept.done("transfer", Traced, trace) if kept else trace()
    progress.update("plan", 0.0, 1.0)
    fixed = dict.fromkeys(options.model, True) | dict.fromkeys(options.leave_out, False)

    def choose() -> _Planned:
        chosen = choose_parts(
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
        return _Planned(*chosen)

    planned = kept.done("plan", _Planned, choose) if kept else choose()
    parts, decisions = planned.parts, planned.decisions
    progress.close()
    if options.json:
        progress.say({"stage": "planned", "decisions": [asdict(decision) for decision in decisions]})
    else:
        for line in decisions:
            print(f"{line.what}: {line.choice} ({line.reason}; {line.costs})", file=sys.stderr, flush=True)
    return of, parts, decisions
