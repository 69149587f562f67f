"""Recovery by the paper's model: both fields fitted by gradient descent."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dante_w.commands.plan_report import (
    Decision,
    embedding,
    light,
    memory,
    own_exposures,
    representation,
    samples,
)
from dante_w.commands.stages import (
    TEXEL_TYPES,
    bake_files,
    begin,
    check_exposed,
    expect_no_fit,
    look,
    pixels,
    prepare,
    say_expected,
    say_plan,
    write_report,
)
from dante_w.contract.errors import BadInput, DanteError
from dante_w.contract.scene_folder import Scene
from dante_w.estimate.expectation import QUALITY, Expectation, Work, predict
from dante_w.estimate.memory import BAKED, cache_bytes, fit_bytes, resident, room
from dante_w.estimate.pace import Fitting, Texture, measure, take
from dante_w.field.divergence import Course
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.held_out import held_out_psnr
from dante_w.field.optimise import LossTerms, fit, photo_ranges
from dante_w.field.presets import Preset as FieldSettings
from dante_w.field.presets import equal_bands, sized
from dante_w.field.scale_ambiguity import albedo_gain, start_exposures
from dante_w.options import RecoverOptions
from dante_w.presets import Preset
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run import distributed
from dante_w.run.checkpoints import Checkpoints, open_checkpoints
from dante_w.run.device import pick_device
from dante_w.run.progress import Progress
from dante_w.run.setbacks import Setback
from dante_w.scene.held_out import choose_held_out
from dante_w.texture.known_colours import known_gain

#: A fit that leaves more than this part of the loss that it began with, and more than this loss, has told nothing.
TOLD_NOTHING, LITTLE = 0.9, 0.05


def recover_field(
    options: RecoverOptions, chosen: Preset, staging: Path, progress: Progress
) -> dict[str, Any]:
    """The paper's model: both fields fitted by gradient descent."""
    device = pick_device(options.device)
    distributed.join(device)
    settings = chosen.field
    spec = equal_bands(settings.model) if options.equal_bands else settings.model
    scene, scene3d, size, texture = prepare(
        options, options.priors, chosen.texture_size, BAKED, staging, progress
    )
    use_prior = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    if options.no_photometric and not use_prior:
        raise BadInput("--no-photometric leaves only the priors, and there are none; add --priors DIR.")
    ours = (0.0, 0.0) if use_prior else (settings.white_light, settings.small_offset)
    terms = LossTerms(not options.no_photometric, options.prior_weight, *ours)
    held_out = choose_held_out(len(scene.frames))
    fitting = _Fitting(settings, spec, terms, device, held_out)
    expected = _expect(options, scene, scene3d, size, fitting, staging, progress)
    held = resident()
    kept = open_checkpoints(options, scene, scene3d.mesh)
    seen = look(scene, scene3d, size, kept, staging, progress, chosen.cast)
    cache, coverage, size = seen.cache, seen.coverage, seen.coverage.width
    if terms.photometric:
        check_exposed(scene, cache)
    everything = photo_ranges(cache, np.arange(len(scene.frames)))
    spec = spec if chosen.name == "paper" else sized(spec, size, cache)
    fitting = dataclasses.replace(fitting, spec=spec)
    plan = _plan(scene, spec, cache, size, texture, held)
    say_plan(options, plan, progress)
    model, score, setbacks = _fit(cache, fitting, options, progress, kept)
    if distributed.rank() > 0:
        return {}
    progress.update("bake", 0.0, 1.0)
    gain = torch.ones(3) if use_prior else albedo_gain(model, cache, everything, options.seed).cpu()

    @torch.no_grad()
    def texels(uv: np.ndarray) -> np.ndarray:
        albedo = model.albedo(torch.from_numpy(uv).float().to(device)).cpu()
        return (albedo * gain).clamp(0.0, 1.0).numpy()

    known = known_gain(texels, coverage, options.known)
    covered = bake_files(
        lambda uv: np.minimum(texels(uv) * known, 1.0),
        scene3d.mesh,
        coverage,
        options.format,
        staging,
        progress,
    )
    return write_report(
        options,
        staging,
        progress,
        device=str(device),
        preset={**dataclasses.asdict(settings), "model": dataclasses.asdict(spec)},
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        plan=[dataclasses.asdict(decision) for decision in plan],
        held_out_photos=[scene.frames[i].image.name for i in held_out],
        held_out_psnr=score,
        setbacks={stage: [dataclasses.asdict(each) for each in found] for stage, found in setbacks.items()},
        albedo_gain=[round(float(g), 4) for g in gain.numpy() * known],
        coverage=covered,
        resumed=kept.resumed,
        texture_size=size,
        expected=expected,
    )


def plan_field(options: RecoverOptions, chosen: Preset, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide how large the paper's model is and say so, without fitting it. Arguments and errors as `recover.recover`."""
    scene, scene3d, size, texture = prepare(
        options, options.priors, chosen.texture_size, BAKED, staging, progress
    )
    expect_no_fit(options, scene, scene3d, size, staging, progress)
    held = resident()
    cache = look(scene, scene3d, size, None, staging, progress).cache
    check_exposed(scene, cache)
    model = chosen.field.model
    spec = model if chosen.name == "paper" else sized(model, size, cache)
    decisions = _plan(scene, spec, cache, size, texture, held)
    say_plan(options, decisions, progress)
    return {
        "plan": [dataclasses.asdict(decision) for decision in decisions],
        "texture_size": size,
        "samples": len(cache),
    }


def _plan(
    scene: Scene, spec: ModelSpec, cache: RayCache, size: int, texture: Decision, held: int
) -> list[Decision]:
    """What the paper's model has, on a machine that held so many bytes before the rays."""
    parts = {"libraries and mesh": held, "samples": cache_bytes(len(cache), cache.prior is not None)}
    fitting, making = fit_bytes(spec), BAKED * size**2
    last = {"fit": fitting} if fitting > making else {"texture": making}
    return [
        texture,
        light("field", True),
        samples(len(cache), pixels(scene.frames), cache.prior is not None),
        memory(sum(parts.values()) + max(fitting, making), room(), parts | last),
        representation(spec),
        embedding(spec.embedding),
        own_exposures(),
    ]


@dataclasses.dataclass(frozen=True)
class _Fitting:
    """What is fitted, to what, and where: the preset's settings, the model's size, the terms of the loss, the device, and the
    held-out photos."""

    settings: FieldSettings
    spec: ModelSpec
    terms: LossTerms
    device: torch.device
    held_out: np.ndarray


def _expect(
    options: RecoverOptions,
    scene: Scene,
    scene3d: Scene3D,
    size: int,
    fitting: _Fitting,
    staging: Path,
    progress: Progress,
) -> dict[str, Any]:
    """What is said of the run before it begins."""
    settings, held_out = fitting.settings, fitting.held_out
    texture = Texture(size, TEXEL_TYPES[options.format])
    work = Work(
        photos=len(scene.frames),
        pixels=pixels(scene.frames),
        texels=size**2,
        held_out_pixels=pixels(scene.frames[i] for i in held_out) if fitting.terms.photometric else 0,
        steps=settings.schedule.steps,
        final_steps=settings.final_pass.steps if len(held_out) and not options.keep_held_out else 0,
    )
    sample = take(scene.frames, scene3d)
    timed = Fitting(fitting.spec, fitting.terms, settings.schedule.batch, fitting.device)
    to_come = predict(measure(sample, scene3d.mesh, texture, staging, timed), work)
    begin(progress, to_come)
    priors = any(frame.albedo for frame in scene.frames) and fitting.terms.prior_weight > 0.0
    as_measured = not (priors or options.equal_bands)
    quality = QUALITY["field"][options.preset] if as_measured else None
    return say_expected(options, Expectation(progress.seconds | to_come, quality), priors, progress)


def _fit(
    cache: RayCache,
    fitting: _Fitting,
    options: RecoverOptions,
    progress: Progress,
    kept: Checkpoints,
) -> tuple[Model, float | None, dict[str, list[Setback]]]:
    """Fit without the held-out photos, score on them, then fit on with all photos; returns model, PSNR, and the stages'
    setbacks.

    Raises:
        DanteError: the fit does not come to anything.
    """
    photos = np.arange(len(cache.starts) - 1)
    settings, terms, held_out, seed = fitting.settings, fitting.terms, fitting.held_out, options.seed

    def report(stage: str) -> Callable[[int, int, float], None]:
        return lambda step, steps, loss: progress.update(stage, step, steps, loss)

    progress.update("optimise", 0, settings.schedule.steps)
    torch.manual_seed(seed)
    model = Model(fitting.spec, len(photos))
    start_exposures(model, cache)
    model.to(fitting.device)
    training = photo_ranges(cache, np.setdiff1d(photos, held_out))
    if len(training) == 0:
        held_out, training = held_out[:0], photo_ranges(cache, photos)
    course = fit(
        model, cache, training, terms, settings.schedule, seed, report("optimise"), None, kept, "fit"
    )
    _check(course)
    setbacks = {"optimise": course.setbacks}
    if len(held_out) == 0:
        return model, None, setbacks
    score = None
    if terms.photometric:
        score, setbacks["held-out"] = held_out_psnr(model, cache, held_out, seed, report("held-out"))
    if not options.keep_held_out:
        everything = photo_ranges(cache, photos)
        schedule = settings.final_pass
        progress.update("final pass", 0, schedule.steps)
        course = fit(
            model, cache, everything, terms, schedule, seed + 1, report("final pass"), None, kept, "final fit"
        )
        setbacks["final pass"] = course.setbacks
    return model, score, setbacks


def _check(course: Course) -> None:
    if not math.isfinite(course.last) or course.last > max(TOLD_NOTHING * course.first, LITTLE):
        raise DanteError(
            "The fit diverged or told nothing, so there is no texture; run again with another --seed or --lambda."
        )
