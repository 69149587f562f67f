"""From a scene to a texture: the commands `recover` and `average`, stage by stage."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dante_w import __version__
from dante_w.color import linear_from_srgb_array
from dante_w.device import peak_memory, pick_device
from dante_w.doctor import library_versions
from dante_w.errors import BadInput, DanteError
from dante_w.expectation import QUALITY, Expectation, Work, predict, since_start
from dante_w.model.fields import Model, ModelSpec
from dante_w.model.gauge import albedo_gain, start_exposures
from dante_w.model.held_out import choose_held_out, held_out_psnr
from dante_w.model.optimise import LossTerms, fit, photo_ranges
from dante_w.model.presets import PRESETS, equal_bands
from dante_w.pace import Fitting, Texture, measure
from dante_w.progress import Progress
from dante_w.rays.ray_cache import RayCache, trace
from dante_w.result_folder import REPORT
from dante_w.scene.images import write_exr, write_png
from dante_w.scene.load import load_scene
from dante_w.scene.mesh import Mesh, write_obj
from dante_w.scene.scene_folder import Frame, Scene
from dante_w.texture.average import PhotoAverage
from dante_w.texture.bake import Texels, bake
from dante_w.texture.coverage import Coverage, empty_coverage, mark
from dante_w.texture.unwrap import unwrap
from dante_w.texture.uvmap import check_uvs
from dante_w.traced.solve import recover_albedo

#: Texels beyond each chart that are painted, so that mipmaps and bilinear lookups do not bleed.
GUTTER = 16
_TEXEL_TYPES = {"png": np.uint8, "png16": np.uint16, "exr": np.float16}


def recover(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Recover the albedo texture into `staging`; returns the report. `options` are the command's.

    Raises:
        BadInput: the scene cannot be used, or there is nothing to fit to; see `load.load_scene`, `uvmap.check_uvs` and `ray_cache.trace`.
    """
    method = _recover_traced if options.irradiance == "traced" else _recover_fitted
    return method(options, staging, progress)


def _recover_fitted(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """The paper's model: both fields fitted by gradient descent."""
    device = pick_device(options.device)
    preset = PRESETS[options.preset]
    spec = equal_bands(preset.model) if options.equal_bands else preset.model
    size = options.texture_size or preset.texture_size
    scene, mesh = _prepare(options, options.priors, size, staging, progress)
    use_prior = options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames)
    if options.no_photometric and not use_prior:
        raise BadInput("--no-photometric leaves only the priors, and there are none; add --priors DIR.")
    ours = (0.0, 0.0) if use_prior else (preset.white_light, preset.small_offset)
    terms = LossTerms(not options.no_photometric, options.prior_weight, *ours)
    held_out = choose_held_out(len(scene.frames))
    fitting = Fitting(spec, terms, preset.schedule.batch, device)
    expected = _expect(options, scene, mesh, held_out, size, fitting, staging, progress)
    coverage = empty_coverage(size, size)

    def visit(uv: np.ndarray, footprint: np.ndarray, _: np.ndarray) -> None:
        mark(coverage, uv, footprint * size)

    cache = _trace(scene, mesh, visit, staging, progress)
    everything = photo_ranges(cache, np.arange(len(scene.frames)))
    model, score = _fit(cache, spec, terms, options, device, held_out, progress)
    if not all(bool(torch.isfinite(parameter).all()) for parameter in model.parameters()):
        raise DanteError(
            "The fit diverged, so there is no texture; run again with another --seed or --lambda."
        )
    progress.update("bake", 0.0, 1.0)
    gain = torch.ones(3) if use_prior else albedo_gain(model, cache, everything, options.seed).cpu()

    @torch.no_grad()
    def texels(uv: np.ndarray) -> np.ndarray:
        albedo = model.albedo(torch.from_numpy(uv).float().to(device)).cpu()
        return (albedo * gain).clamp(0.0, 1.0).numpy()

    seen = _bake(texels, mesh, coverage, options.format, staging, progress)
    return _report(
        options,
        staging,
        progress,
        device=str(device),
        preset={**dataclasses.asdict(preset), "model": dataclasses.asdict(spec)},
        photos=len(scene.frames),
        samples=len(cache),
        priors=sum(frame.albedo is not None for frame in scene.frames),
        held_out_photos=[scene.frames[i].image.name for i in held_out],
        held_out_psnr=score,
        albedo_gain=[round(float(g), 4) for g in gain],
        coverage=seen,
        texture_size=size,
        expected=expected,
    )


def _recover_traced(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Light traced through the mesh: lights first, then the albedo in closed form."""
    size = options.texture_size or PRESETS[options.preset].texture_size
    if options.no_photometric or options.equal_bands:
        raise BadInput("--no-photometric and --equal-bands belong to --irradiance field; leave them out.")
    scene, mesh = _prepare(options, options.priors, size, staging, progress)
    if options.prior_weight > 0.0 and any(frame.albedo for frame in scene.frames):
        raise BadInput("--irradiance traced does not use priors yet; leave them out or give --lambda 0.")
    work = Work(len(scene.frames), _pixels(scene.frames), size**2)
    image = Texture(size, _TEXEL_TYPES[options.format], GUTTER)
    _begin(progress, predict(measure(scene.frames, mesh, image, staging), work))
    coverage, footprints = empty_coverage(size, size), []

    def visit(uv: np.ndarray, footprint: np.ndarray, _: np.ndarray) -> None:
        mark(coverage, uv, footprint * size)
        footprints.append(footprint.astype(np.float32))

    cache = _trace(scene, mesh, visit, staging, progress)
    texture, facts = recover_albedo(
        cache, np.concatenate(footprints), mesh, scene.frames, size, options.seed, progress
    )
    seen = _bake(_nearest(texture), mesh, coverage, options.format, staging, progress)
    return _report(
        options,
        staging,
        progress,
        photos=len(scene.frames),
        samples=len(cache),
        held_out_psnr=None,
        coverage=seen,
        texture_size=size,
        **facts,
    )


def average(options: argparse.Namespace, staging: Path, progress: Progress) -> dict[str, Any]:
    """Average the photos on the texture, light and all: the baseline. Same files and errors as `recover`."""
    size = options.texture_size or PRESETS["standard"].texture_size
    scene, mesh = _prepare(options, None, size, staging, progress)
    work = Work(len(scene.frames), _pixels(scene.frames), size**2)
    image = Texture(size, _TEXEL_TYPES[options.format], GUTTER)
    _begin(progress, predict(measure(scene.frames, mesh, image, staging), work))
    coverage, mean = empty_coverage(size, size), PhotoAverage(size, size)

    def visit(uv: np.ndarray, footprint: np.ndarray, srgb: np.ndarray) -> None:
        mark(coverage, uv, footprint * size)
        mean.add(uv, linear_from_srgb_array(srgb), 1.0, footprint * size)

    cache = _trace(scene, mesh, visit, staging, progress)
    seen = _bake(_nearest(mean.resolve()), mesh, coverage, options.format, staging, progress)
    facts = {"photos": len(scene.frames), "samples": len(cache), "coverage": seen, "texture_size": size}
    return _report(options, staging, progress, **facts)


def _nearest(texture: np.ndarray) -> Texels:
    """The texels of a square texture that is there already."""
    size = len(texture)

    def texels(uv: np.ndarray) -> np.ndarray:
        column = (uv[:, 0] * size).astype(np.int64).clip(0, size - 1)
        row = ((1.0 - uv[:, 1]) * size).astype(np.int64).clip(0, size - 1)
        return np.minimum(texture[row, column], 1.0)

    return texels


def _prepare(
    options: argparse.Namespace, priors: Path | None, size: int, staging: Path, progress: Progress
) -> tuple[Scene, Mesh]:
    scene, mesh = load_scene(options.scene, options.mesh, options.images, priors)
    progress.update("scene", 1, 1)
    if options.unwrap:
        mesh = unwrap(mesh, lambda done: progress.update("unwrap", done, 1.0), size)
        write_obj(staging / "mesh.obj", mesh)
    check_uvs(mesh.uvs, options.mesh or scene.mesh or scene.source)
    return scene, mesh


def _expect(
    options: argparse.Namespace,
    scene: Scene,
    mesh: Mesh,
    held_out: np.ndarray,
    size: int,
    fitting: Fitting,
    staging: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Say what the run will take and what its preset reached elsewhere; returns that for the report."""
    preset, texture = PRESETS[options.preset], Texture(size, _TEXEL_TYPES[options.format], GUTTER)
    work = Work(
        photos=len(scene.frames),
        pixels=_pixels(scene.frames),
        texels=size**2,
        held_out_pixels=_pixels(scene.frames[i] for i in held_out) if fitting.terms.photometric else 0,
        steps=preset.schedule.steps,
        final_steps=preset.final_pass.steps if len(held_out) and not options.keep_held_out else 0,
    )
    to_come = predict(measure(scene.frames, mesh, texture, staging, fitting), work)
    _begin(progress, to_come)
    priors = any(frame.albedo for frame in scene.frames) and fitting.terms.prior_weight > 0.0
    as_measured = not (priors or options.equal_bands)
    expected = Expectation(progress.seconds | to_come, QUALITY[options.preset] if as_measured else None)
    if options.json:
        progress.say({"stage": "expected", **expected.as_dict()})
    else:
        print(expected.sentence(options.preset, priors), file=sys.stderr, flush=True)
    return expected.as_dict()


def _begin(progress: Progress, to_come: dict[str, float]) -> None:
    """End the stages that only prepare, count the time before them as one more, and expect the others."""
    progress.close()
    start = max(since_start() - sum(progress.seconds.values()), 0.0)
    progress.seconds = {"start": round(start, 3), **progress.seconds}
    progress.expect(to_come)


def _pixels(frames: Iterable[Frame]) -> int:
    return sum(frame.camera.width * frame.camera.height for frame in frames)


def _trace(
    scene: Scene,
    mesh: Mesh,
    visit: Callable[[np.ndarray, np.ndarray, np.ndarray], None],
    staging: Path,
    progress: Progress,
) -> RayCache:
    spill = staging / "rays"
    spill.mkdir()
    progress.update("rays", 0.0, 1.0)
    return trace(mesh, scene.frames, visit, lambda done: progress.update("rays", done, 1.0), spill)


def _fit(
    cache: RayCache,
    spec: ModelSpec,
    terms: LossTerms,
    options: argparse.Namespace,
    device: torch.device,
    held_out: np.ndarray,
    progress: Progress,
) -> tuple[Model, float | None]:
    """Fit without the held-out photos, score on them, then fit on with all photos; returns model and PSNR."""
    photos = np.arange(len(cache.starts) - 1)
    preset, seed = PRESETS[options.preset], options.seed

    def report(stage: str) -> Callable[[int, int, float], None]:
        return lambda step, steps, loss: progress.update(stage, step, steps, loss)

    progress.update("optimise", 0, preset.schedule.steps)
    torch.manual_seed(seed)
    model = Model(spec, len(photos))
    start_exposures(model, cache)
    model.to(device)
    training = photo_ranges(cache, np.setdiff1d(photos, held_out))
    if len(training) == 0:
        held_out, training = held_out[:0], photo_ranges(cache, photos)
    fit(model, cache, training, terms, preset.schedule, seed, report("optimise"))
    if len(held_out) == 0:
        return model, None
    score = held_out_psnr(model, cache, held_out, seed, report("held-out")) if terms.photometric else None
    if not options.keep_held_out:
        everything = photo_ranges(cache, photos)
        progress.update("final pass", 0, preset.final_pass.steps)
        fit(model, cache, everything, terms, preset.final_pass, seed + 1, report("final pass"))
    return model, score


def _bake(
    texels: Texels, mesh: Mesh, coverage: Coverage, kind: str, staging: Path, progress: Progress
) -> float:
    """Write the albedo and coverage images; returns the fraction of the texels on the mesh that were seen."""
    assert mesh.uvs is not None
    shape = (coverage.height, coverage.width)
    files = {"albedo.raw": (*shape, 3), "coverage.raw": shape}
    kinds = {"albedo.raw": _TEXEL_TYPES[kind], "coverage.raw": np.uint8}
    out, marks = (np.memmap(staging / name, kinds[name], "w+", shape=files[name]) for name in files)
    seen = bake(
        texels, mesh.uvs, coverage, GUTTER, out, marks, lambda done: progress.update("bake", done, 1.0)
    )
    progress.update("write", 0, 1)
    if kind == "exr":
        write_exr(staging / "albedo.exr", out)
    else:
        write_png(staging / "albedo.png", out)
    write_png(staging / "coverage.png", marks)
    del out, marks
    for name in files:
        (staging / name).unlink()
    progress.update("write", 1, 1)
    return seen


def _report(options: argparse.Namespace, staging: Path, progress: Progress, **facts: Any) -> dict[str, Any]:
    """Write report.json; returns its content."""
    progress.close()
    report = {
        "dante_w": __version__,
        "settings": {name: str(v) if isinstance(v, Path) else v for name, v in vars(options).items()},
        **facts,
        "seconds": progress.seconds,
        "peak_memory_bytes": peak_memory(),
        "versions": library_versions(),
    }
    (staging / REPORT).write_text(json.dumps(report, indent=1), encoding="utf-8")
    return report
