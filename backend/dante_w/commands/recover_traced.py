"""Recovery by light traced through the mesh: lights first, then the albedo in closed form; and its plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dante_w.commands.plan_report import directions, light, memory, normals, samples, time
from dante_w.commands.stages import (
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
from dante_w.estimate.expectation import Expectation, quality
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
from dante_w.estimate.seconds import Probe, Work, measure, predict, traced_row, with_typical_light
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
    checkpoints = open_checkpoints(options, preset, scene, scene3d.mesh)
    seen = look(scene, scene3d, start.size, checkpoints, staging, progress, preset.cast)
    cache, coverage, size = seen.cache, seen.coverage, seen.coverage.width
    check_exposed(scene, cache)
    traced, selection, decisions = _plan(start, cache, settings, progress, checkpoints)
    work = _work(start, cache, traced, selection)
    progress.expect(predict(work, start.row, start.probe))
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
        work=asdict(work),
        probe=asdict(start.probe),
        **facts,
    )


def plan_traced(options: RecoverOptions, preset: Preset, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide what to model and say so, without doing it. Arguments and errors as `recover.recover`."""
    settings = replace(preset.traced_settings(), directions=PLAN_DIRECTIONS)
    start = _start(options, preset, staging, progress)
    stages = ("rays", LIGHT_TRANSPORT, "plan")
    progress.expect({stage: each for stage, each in progress.expected.items() if stage in stages})
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
    """A run before its rays: how large its texture is to be and why, the bytes that it held, and what it is expected to take: its
    `work`, by a `row` of the table of seconds, on the machine that was probed."""

    options: RecoverOptions
    preset: Preset
    scene: Scene
    scene3d: Scene3D
    size: int
    texture: Decision
    held: int
    expected: dict[str, Any]
    row: str
    work: Work
    probe: Probe


def _start(options: RecoverOptions, preset: Preset, staging: Path, progress: Progress) -> _Start:
    settings = preset.traced_settings()
    scene, scene3d, size, texture, sample_count = prepare(
        options, options.priors, preset.texture_size, AVERAGED, staging, progress
    )
    row, most_views = traced_row(preset.name), settings.shading.thinning.photos
    work = Work(pixels(scene.frames), sample_count, size**2)
    work = with_typical_light(work, preset.name, len(scene.frames), most_views)
    probe = measure()
    to_come = predict(work, row, probe)
    begin(progress, to_come)
    priors = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    figures = None if priors else quality("traced", preset.name)
    expectation = Expectation(progress.seconds | to_come, figures)
    if options.out is not None:
        say_expected(options, expectation, priors, progress)
    expected = expectation.as_dict()
    return _Start(options, preset, scene, scene3d, size, texture, resident(), expected, row, work, probe)


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
    to_come = predict(_work(start, cache, traced, selection), start.row, start.probe)
    seconds = start.expected["seconds"] | to_come
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


def _work(start: _Start, cache: RayCache, traced: TracedScene, selection: Selection) -> Work:
    """The run's work, now that it is known."""
    return replace(
        start.work,
        samples=len(cache),
        points=len(traced.points),
        observations=len(traced.observations.point),
        lights=_lights(traced, selection),
    )


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
