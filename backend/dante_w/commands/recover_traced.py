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
from dante_w.contract.vocabulary import LIGHT_TRANSPORT, component
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
from dante_w.options import RecoverOptions
from dante_w.presets import Preset
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run.checkpoints import Checkpoints, open_checkpoints
from dante_w.run.progress import Progress
from dante_w.scene.held_out import choose_held_out
from dante_w.texture.known_colours import known_gain
from dante_w.traced.model_selection import Fixed, Selection, select_components
from dante_w.traced.pipeline import Recovery, recover_albedo, trace_scene
from dante_w.traced.settings import TracedSettings
from dante_w.traced.shading_points import USUAL_SHADING
from dante_w.traced.state import TracedScene

#: Directions of light for a plan alone: fewer than a recovery takes.
PLAN_DIRECTIONS = 64


def recover_traced(
    options: RecoverOptions, preset: Preset, staging: Path, progress: Progress
) -> dict[str, Any]:
    """Light traced through the mesh. Arguments and errors as `recover.recover`."""
    settings = preset.traced_settings()
    start = _start(options, preset, staging, progress)
    scene, scene3d = start.scene, start.scene3d
    checkpoints = open_checkpoints(options, scene, scene3d.mesh)
    seen = look(scene, scene3d, start.size, checkpoints, staging, progress, preset.cast)
    cache, coverage, size = seen.cache, seen.coverage, seen.coverage.width
    check_exposed(scene, cache)
    traced, selection, decisions = _plan(start, cache, settings, progress, checkpoints)
    progress.expect(_seconds_to_come(start, cache, traced, selection))
    lighting = selection.lighting if settings.goes_on else None
    wanted = Recovery(size, selection.components, lighting, options.seed)
    texture, facts = recover_albedo(traced, cache, scene3d, wanted, settings, progress, checkpoints)
    gain = known_gain(nearest(texture), coverage, options.known)
    covered = bake_files(nearest(texture * gain), scene3d.mesh, coverage, options.format, staging, progress)
    return write_report(
        options,
        staging,
        progress,
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        plan=[asdict(decision) for decision in decisions],
        coverage=covered,
        resumed=checkpoints.resumed,
        albedo_gain=[round(float(g), 4) for g in gain],
        held_out_photos=[scene.frames[i].image.name for i in choose_held_out(len(scene.frames))],
        texture_size=size,
        expected=start.expected,
        **facts,
    )


def plan_traced(options: RecoverOptions, preset: Preset, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide what to model and say so, without doing it. Arguments and errors as `recover.recover`."""
    settings = replace(preset.traced_settings(), directions=PLAN_DIRECTIONS)
    start = _start(options, preset, staging, progress)
    progress.expect({stage: progress.expected[stage] for stage in ("rays", LIGHT_TRANSPORT, "plan")})
    cache = look(start.scene, start.scene3d, start.size, None, staging, progress).cache
    check_exposed(start.scene, cache)
    decisions = _plan(start, cache, settings, progress)[2]
    return {
        "plan": [asdict(decision) for decision in decisions],
        "texture_size": start.size,
        "samples": len(cache),
    }


@dataclass(frozen=True)
class _Start:
    """A run before its rays: how large its texture is to be and why, the bytes that it held, and what it is expected to take:
    `later` stages from `pace` and `work` and by themselves."""

    options: RecoverOptions
    preset: Preset
    scene: Scene
    scene3d: Scene3D
    size: int
    texture: Decision
    held: int
    expected: dict[str, Any]
    pace: TracedPace
    work: TracedWork
    later: dict[str, float]


def _start(options: RecoverOptions, preset: Preset, staging: Path, progress: Progress) -> _Start:
    settings = preset.traced_settings()
    scene, scene3d, size, texture = prepare(
        options, options.priors, preset.texture_size, AVERAGED, staging, progress
    )
    sample = take(scene.frames, scene3d)
    all_pixels, kind = pixels(scene.frames), TEXEL_TYPES[options.format]
    work = Work(len(scene.frames), all_pixels, size**2)
    around = predict(measure(sample, scene3d.mesh, Texture(size, kind), staging), work)
    suns = _fixed(options, preset).get("sun", Fixed(True)).on
    finer = settings.shading.side // USUAL_SHADING.side
    pace, own = measure_traced(
        sample, len(scene.frames), all_pixels, settings.directions, size**2, suns, settings.goes_on, finer
    )
    later = {name: around.pop(name) for name in ("bake", "write")}
    to_come = around | predict_traced(pace, own) | later
    begin(progress, to_come)
    priors = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    quality = None if priors else QUALITY["traced"][preset.name]
    expectation = Expectation(progress.seconds | to_come, quality)
    if options.out is not None:
        say_expected(options, expectation, priors, progress)
    expected = expectation.as_dict()
    return _Start(options, preset, scene, scene3d, size, texture, resident(), expected, pace, own, later)


def _plan(
    start: _Start,
    cache: RayCache,
    settings: TracedSettings,
    progress: Progress,
    checkpoints: Checkpoints | None = None,
) -> tuple[TracedScene, Selection, list[Decision]]:
    """Trace light, decide what to model, and say so."""
    options = start.options

    def trace() -> TracedScene:
        return trace_scene(cache, start.scene3d, start.scene.frames, settings, options.prior_weight, progress)

    traced = checkpoints.done(LIGHT_TRANSPORT, TracedScene, trace) if checkpoints else trace()
    progress.update("plan", 0.0, 1.0)

    def choose() -> Selection:
        return select_components(
            traced,
            _fixed(options, start.preset),
            options.seed,
            lambda done, trials: progress.update("plan", done, trials),
            settings.selection,
            settings.solver,
            settings.sun,
        )

    selection = checkpoints.done("plan", Selection, choose) if checkpoints else choose()
    seconds = start.expected["seconds"] | _seconds_to_come(start, cache, traced, selection)
    usual = start.preset.traced_settings().directions
    decisions = [
        start.texture,
        light("traced", options.irradiance is not None),
        normals(start.scene3d.mesh.normals is not None),
        directions(usual, options.preset, len(traced.points)),
        samples(len(cache), pixels(start.scene.frames), cache.prior is not None),
        _memory(start, cache, traced, _lights(traced, selection)),
        time(seconds),
        *selection.decisions,
    ]
    say_plan(options, decisions, progress)
    return traced, selection, decisions


def _lights(traced: TracedScene, selection: Selection) -> int:
    """How many lights to expect."""
    if selection.lighting:
        return len(selection.lighting.radiance)
    return int(traced.clusters.max()) + 1 if selection.components.clusters else 1


def _fixed(options: RecoverOptions, preset: Preset) -> dict[str, Fixed]:
    """The components that the preset decides, and the user, who has the last word."""
    reason = Fixed(False, f"the preset {preset.name} leaves it out")
    by_preset = dict.fromkeys(preset.traced_settings().left_out, reason)
    modelled, left_out = (
        [component(word).name for word in words] for words in (options.model, options.leave_out)
    )
    by_user = dict.fromkeys(modelled, Fixed(True)) | dict.fromkeys(left_out, Fixed(False))
    return by_preset | by_user


def _seconds_to_come(
    start: _Start, cache: RayCache, traced: TracedScene, selection: Selection
) -> dict[str, float]:
    """Seconds of the stages from light transport on, now that it is known what there is to do."""
    work = replace(
        start.work,
        samples=len(cache),
        points=len(traced.points),
        observations=len(traced.observations.point),
        lights=_lights(traced, selection),
        suns=selection.components.sun,
        goes_on=start.work.goes_on and selection.lighting is not None,
    )
    return predict_traced(start.pace, work) | start.later


def _memory(start: _Start, cache: RayCache, traced: TracedScene, lights: int) -> Decision:
    """What the run will need at most: while lights are solved for, or while the texture is made."""
    count, photos = start.preset.traced_settings().directions, len(traced.cameras)
    held = {
        "libraries and mesh": start.held + LATER,
        "samples": cache_bytes(len(cache), cache.prior is not None),
        "light transport": TRANSFER * len(traced.points) * count + BOUNCE * len(traced.transport.weight),
    }
    solving = lights_bytes(len(traced.observations.point), lights, count, photos)
    making = texture_bytes(start.size, int(np.diff(cache.starts).max()))
    last = {"lights": solving} if solving > making else {"texture": making}
    return memory(sum(held.values()) + max(solving, making), room(), held | last)
