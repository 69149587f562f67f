"""Recovery by light traced through the mesh: lights first, then the albedo in closed form; and its plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dante_w.commands.plan_report import directions, light, memory, normals, samples, time
from dante_w.commands.stages import (
    TEXEL_TYPES,
    bake_files,
    begin,
    check_exposed,
    look,
    nearest,
    pixels,
    prepare,
    say_expected,
    say_plan,
    write_report,
)
from dante_w.contract.protocol import Decision
from dante_w.contract.scene_folder import Scene
from dante_w.contract.vocabulary import component
from dante_w.estimate.expectation import QUALITY, Expectation, Work, predict
from dante_w.estimate.memory import (
    AVERAGED,
    BOUNCE,
    LATER,
    TRANSFER,
    cache_bytes,
    lights_bytes,
    resident,
    room,
    texture_bytes,
)
from dante_w.estimate.pace import Texture, measure, take
from dante_w.estimate.traced_pace import TracedPace, TracedWork, measure_traced, predict_traced
from dante_w.field.presets import PRESETS
from dante_w.options import RecoverOptions
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run.checkpoints import Checkpoints, open_checkpoints
from dante_w.run.progress import Progress
from dante_w.scene.held_out import choose_held_out
from dante_w.texture.known_colours import known_gain
from dante_w.traced.model_selection import Fixed, select_components
from dante_w.traced.pipeline import TracedScene, examine, recover_albedo
from dante_w.traced.state import Components, Lighting

#: Directions that light comes from: fewer lose the shadows' edges, more cost time (squared) and tell no more.
DIRECTIONS = {"draft": 64, "standard": 256, "high": 256, "paper": 256}
#: Shading points along either side of the texture, in multiples of `shading_points.SIDE`.
FINER = {"high": 2}
#: Components that a preset leaves out: on the bust of the README suns take a third of `draft`'s time, for 1.7 dB after gain.
LEFT_OUT = {"draft": ("sun",)}
#: Presets whose lights go on from those that the plan has found. With `standard` that is 4 s less, too, but loses 0.17 dB after gain and 0.3
#: as it is (means of four objects and three seeds).
GOES_ON = ("draft",)
#: For a plan alone.
FEW_DIRECTIONS = 64


def recover_traced(options: RecoverOptions, staging: Path, progress: Progress) -> dict[str, Any]:
    """Light traced through the mesh. Arguments and errors as `recover.recover`."""
    begun = _start(options, staging, progress)
    scene, scene3d = begun.scene, begun.scene3d
    kept = open_checkpoints(options, scene, scene3d.mesh)
    seen = look(scene, scene3d, begun.size, kept, staging, progress)
    cache, coverage, size = seen.cache, seen.coverage, seen.coverage.width
    check_exposed(scene, cache)
    of, planned, plan = _plan(options, begun, cache, DIRECTIONS[options.preset], progress, kept)
    progress.expect(_to_come(begun, cache, of, planned))
    lights = planned.begun if options.preset in GOES_ON else None
    texture, facts = recover_albedo(
        of, cache, scene3d, size, planned.parts, lights, options.seed, progress, kept
    )
    texels = nearest(texture)
    gain = known_gain(texels, coverage, options.known)
    covered = bake_files(nearest(texture * gain), scene3d.mesh, coverage, options.format, staging, progress)
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
        expected=begun.expected,
        **facts,
    )


def plan_traced(options: RecoverOptions, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide what to model and say so, without doing it. Arguments and errors as `recover.recover`."""
    begun = _start(options, staging, progress)
    progress.expect({stage: progress.expected[stage] for stage in ("rays", "transfer", "plan")})
    cache = look(begun.scene, begun.scene3d, begun.size, None, staging, progress).cache
    check_exposed(begun.scene, cache)
    decisions = _plan(options, begun, cache, FEW_DIRECTIONS, progress)[2]
    return {
        "plan": [asdict(decision) for decision in decisions],
        "texture_size": begun.size,
        "samples": len(cache),
    }


@dataclass(frozen=True)
class _Begun:
    """A run before its rays: how large its texture is to be and why, the bytes that it held, and what it is expected to take:
    `later` stages from `pace` and `work` and by themselves."""

    scene: Scene
    scene3d: Scene3D
    size: int
    texture: Decision
    held: int
    expected: dict[str, Any]
    pace: TracedPace
    work: TracedWork
    later: dict[str, float]


def _start(options: RecoverOptions, staging: Path, progress: Progress) -> _Begun:
    scene, scene3d, size, texture = prepare(
        options, options.priors, PRESETS[options.preset].texture_size, AVERAGED, staging, progress
    )
    sample = take(scene.frames, scene3d)
    all_pixels, kind = pixels(scene.frames), TEXEL_TYPES[options.format]
    work = Work(len(scene.frames), all_pixels, size**2)
    around = predict(measure(sample, scene3d.mesh, Texture(size, kind), staging), work)
    count = DIRECTIONS[options.preset]
    suns = _fixed(options).get("sun", Fixed(True)).on
    finer = FINER.get(options.preset, 1)
    goes_on = options.preset in GOES_ON
    pace, own = measure_traced(sample, len(scene.frames), all_pixels, count, size**2, suns, goes_on, finer)
    later = {name: around.pop(name) for name in ("bake", "write")}
    to_come = around | predict_traced(pace, own) | later
    begin(progress, to_come)
    priors = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    quality = None if priors else QUALITY["traced"][options.preset]
    expectation = Expectation(progress.seconds | to_come, quality)
    if options.out is not None:
        say_expected(options, expectation, priors, progress)
    expected = expectation.as_dict()
    return _Begun(scene, scene3d, size, texture, resident(), expected, pace, own, later)


@dataclass(frozen=True)
class _Planned:
    parts: Components
    decisions: list[Decision]
    begun: Lighting | None

    def lights(self, of: TracedScene) -> int:
        """How many to expect."""
        if self.begun:
            return len(self.begun.radiance)
        return int(of.groups.max()) + 1 if self.parts.clusters else 1


def _plan(
    options: RecoverOptions,
    begun: _Begun,
    cache: RayCache,
    count: int,
    progress: Progress,
    kept: Checkpoints | None = None,
) -> tuple[TracedScene, _Planned, list[Decision]]:
    """Trace light from `count` directions, decide what to model, and say so."""

    def trace() -> TracedScene:
        finer, frames = FINER.get(options.preset, 1), begun.scene.frames
        return examine(cache, begun.scene3d, frames, count, options.prior_weight, progress, finer)

    of = kept.done("transfer", TracedScene, trace) if kept else trace()
    progress.update("plan", 0.0, 1.0)

    def choose() -> _Planned:
        chosen = select_components(
            of.cameras,
            of.points,
            of.seen,
            of.transfer,
            of.exposures,
            of.groups,
            _fixed(options),
            options.seed,
            lambda done, trials: progress.update("plan", done, trials),
        )
        return _Planned(*chosen)

    planned = kept.done("plan", _Planned, choose) if kept else choose()
    seconds = begun.expected["seconds"] | _to_come(begun, cache, of, planned)
    decisions = [
        begun.texture,
        light("traced", options.irradiance is not None),
        normals(begun.scene3d.mesh.normals is not None),
        directions(DIRECTIONS[options.preset], options.preset, len(of.points)),
        samples(len(cache), pixels(begun.scene.frames), cache.prior is not None),
        _memory(options, begun, cache, of, planned.lights(of)),
        time(seconds),
        *planned.decisions,
    ]
    say_plan(options, decisions, progress)
    return of, planned, decisions


def _fixed(options: RecoverOptions) -> dict[str, Fixed]:
    """The parts that the preset decides, and the user, who has the last word."""
    by_preset = dict.fromkeys(LEFT_OUT.get(options.preset, ()), Fixed(False, f"the preset {options.preset}"))
    modelled, left_out = (
        [component(word).name for word in words] for words in (options.model, options.leave_out)
    )
    by_user = dict.fromkeys(modelled, Fixed(True)) | dict.fromkeys(left_out, Fixed(False))
    return by_preset | by_user


def _to_come(begun: _Begun, cache: RayCache, of: TracedScene, planned: _Planned) -> dict[str, float]:
    """Seconds of the stages from `transfer` on, now that it is known what there is to do."""
    work = replace(
        begun.work,
        samples=len(cache),
        points=len(of.points),
        observations=len(of.seen.point),
        lights=planned.lights(of),
        suns=planned.parts.sun,
        goes_on=begun.work.goes_on and planned.begun is not None,
    )
    return predict_traced(begun.pace, work) | begun.later


def _memory(
    options: RecoverOptions, begun: _Begun, cache: RayCache, of: TracedScene, lights: int
) -> Decision:
    """What the run will need at most: while lights are solved for, or while the texture is made."""
    count, photos = DIRECTIONS[options.preset], len(of.cameras)
    held = {
        "libraries and mesh": begun.held + LATER,
        "samples": cache_bytes(len(cache), cache.prior is not None),
        "transfer": TRANSFER * len(of.points) * count + BOUNCE * len(of.transfer.weight),
    }
    solving = lights_bytes(len(of.seen.point), lights, count, photos)
    making = texture_bytes(begun.size, int(np.diff(cache.starts).max()))
    last = {"lights": solving} if solving > making else {"texture": making}
    return memory(sum(held.values()) + max(solving, making), room(), held | last)
