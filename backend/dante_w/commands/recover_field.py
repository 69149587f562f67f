"""Recovery by the paper's model: both fields fitted by gradient descent."""

from __future__ import annotations

import dataclasses
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
    bake_files,
    begin,
    check_exposed,
    expect_average,
    look,
    pixels,
    prepare,
    say_expected,
    say_plan,
    write_report,
)
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Scene
from dante_w.estimate.expectation import Expectation, quality
from dante_w.estimate.memory import BAKED, cache_bytes, fit_bytes, resident, room
from dante_w.estimate.seconds import Work, measure, predict
from dante_w.field.fields import FieldSpec
from dante_w.field.optimise import photo_ranges
from dante_w.field.pipeline import FieldRun, albedo_lookup, fit_field
from dante_w.field.resolution import with_equal_bands
from dante_w.field.scale_ambiguity import albedo_gain
from dante_w.options import RecoverOptions
from dante_w.presets import Preset
from dante_w.rays.ray_cache import RayCache
from dante_w.run import distributed
from dante_w.run.checkpoints import open_checkpoints
from dante_w.run.device import pick_device
from dante_w.run.progress import Progress
from dante_w.scene.held_out import choose_held_out
from dante_w.texture.known_colours import known_gain


def recover_field(
    options: RecoverOptions, chosen: Preset, staging: Path, progress: Progress
) -> dict[str, Any]:
    """The paper's model: both fields fitted by gradient descent."""
    device = pick_device(options.device)
    distributed.join(device)
    settings = chosen.field
    if options.equal_bands:
        settings = dataclasses.replace(settings, model=with_equal_bands(settings.model))
    scene, scene3d, size, texture, sample_count = prepare(
        options, options.priors, chosen.texture_size, BAKED, staging, progress
    )
    use_prior = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    if options.no_photometric and not use_prior:
        raise BadInput("--no-photometric leaves only the priors, and there are none; add --priors DIR.")
    terms = settings.terms(options.prior_weight, use_prior, not options.no_photometric)
    held_out = choose_held_out(len(scene.frames))
    final_pass = not options.keep_held_out
    run = FieldRun(settings, terms, held_out, device, options.seed, final_pass)
    probe = measure(device.type)
    to_come = predict(_work(options, scene, run, size, sample_count), "field", probe, device.type)
    begin(progress, to_come)
    figures = None if use_prior or options.equal_bands else quality("field", chosen.name)
    expected = say_expected(options, Expectation(progress.seconds | to_come, figures), use_prior, progress)
    held = resident()
    kept = open_checkpoints(options, chosen, scene, scene3d.mesh)
    seen = look(scene, scene3d, size, kept, staging, progress, chosen.cast)
    cache, coverage, size = seen.cache, seen.coverage, seen.coverage.width
    if terms.photometric:
        check_exposed(scene, cache)
    everything = photo_ranges(cache, np.arange(len(scene.frames)))
    settings = dataclasses.replace(settings, model=settings.spec_for(size, cache))
    plan = _plan(scene, settings.model, cache, size, texture, held)
    say_plan(options, plan, progress)
    run = dataclasses.replace(run, settings=settings)
    work = _work(options, scene, run, size, len(cache))
    progress.expect(predict(work, "field", probe, device.type))
    result = fit_field(cache, run, progress, kept)
    if distributed.rank() > 0:
        return {}
    progress.update("bake", 0.0, 1.0)
    gain = torch.ones(3)
    if not use_prior:
        gain = albedo_gain(result.model, cache, everything, options.seed, settings.scale).cpu()
    texels = albedo_lookup(result.model, gain)
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
        preset={"texture_size": chosen.texture_size, **dataclasses.asdict(settings)},
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        plan=[dataclasses.asdict(decision) for decision in plan],
        held_out_photos=[scene.frames[i].image.name for i in held_out],
        held_out_psnr=result.held_out_psnr,
        setbacks={
            stage: [dataclasses.asdict(each) for each in found] for stage, found in result.setbacks.items()
        },
        albedo_gain=[round(float(g), 4) for g in gain.numpy() * known],
        coverage=covered,
        resumed=kept.resumed,
        texture_size=size,
        expected=expected,
        work=dataclasses.asdict(work),
        probe=dataclasses.asdict(probe),
    )


def plan_field(options: RecoverOptions, chosen: Preset, staging: Path, progress: Progress) -> dict[str, Any]:
    """Decide how large the paper's model is and say so, without fitting it. Arguments and errors as `recover.recover`."""
    scene, scene3d, size, texture, sample_count = prepare(
        options, options.priors, chosen.texture_size, BAKED, staging, progress
    )
    expect_average(scene, size, sample_count, progress)
    held = resident()
    cache = look(scene, scene3d, size, None, staging, progress).cache
    check_exposed(scene, cache)
    spec = chosen.field.spec_for(size, cache)
    decisions = _plan(scene, spec, cache, size, texture, held)
    say_plan(options, decisions, progress)
    return {
        "plan": [dataclasses.asdict(decision) for decision in decisions],
        "texture_size": size,
        "samples": len(cache),
    }


def _plan(
    scene: Scene, spec: FieldSpec, cache: RayCache, size: int, texture: Decision, held: int
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


def _work(options: RecoverOptions, scene: Scene, run: FieldRun, size: int, sample_count: int) -> Work:
    """How much a run has to do, with so many samples."""
    settings, photos, held_out = run.settings, len(scene.frames), len(run.held_out)
    spec, scoring = settings.model, settings.held_out.schedule
    each = sum(grid.levels << grid.dimensions for grid in (spec.albedo, spec.irradiance))
    scored = scoring.steps * scoring.batch + sample_count * held_out / (2 * photos)
    final = settings.final_pass if held_out and run.final_pass else None
    return Work(
        pixels(scene.frames),
        sample_count,
        size**2,
        lookups=each * settings.schedule.steps * settings.schedule.batch,
        held_out_lookups=each * scored if held_out and run.terms.photometric else 0.0,
        final_lookups=each * final.steps * final.batch if final else 0.0,
    )
