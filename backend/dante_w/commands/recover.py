"""The commands `recover`, `plan` and `average`: from a scene to a texture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dante_w.commands.recover_field import plan_field, recover_field
from dante_w.commands.recover_traced import plan_traced, recover_traced
from dante_w.commands.stages import bake_files, expect_average, nearest, prepare, trace_rays, write_report
from dante_w.contract.errors import BadInput
from dante_w.contract.vocabulary import component
from dante_w.core.color import linear_from_srgb_array
from dante_w.estimate.memory import AVERAGED
from dante_w.options import RecoverOptions
from dante_w.presets import PRESETS, Preset
from dante_w.run import distributed
from dante_w.run.progress import Progress
from dante_w.run.result_files import names_to_write
from dante_w.run.result_folder import abandon, publish, stage
from dante_w.texture.coverage import empty_coverage, mark
from dante_w.texture.photo_average import PhotoAverage


def recover(options: RecoverOptions, settings: Preset | None = None) -> dict[str, Any]:
    """Recover the albedo texture into `options.out`, in this process; returns what report.json holds.

    Args:
        options: what the command line offers, with `out`.
        settings: numbers of both models, in place of those of the preset; see `presets.PRESETS`.

    Raises:
        DanteError: what the command ends with, see `contract.errors`; a former result stays as it was.

    Example:
        report = recover(RecoverOptions(Path("scene"), out=Path("result"), preset="draft"))
    """
    if options.out is None:
        raise BadInput("A recovery needs a folder for its result; name one as out.")
    staging = stage(options.out, names_to_write(options.format, options.unwrap))
    try:
        report = recover_into(options, staging, Progress(as_json=False), settings)
        publish(options.out)
    except BaseException:
        abandon(options.out)
        raise
    return report


def recover_into(
    options: RecoverOptions, staging: Path, progress: Progress, settings: Preset | None = None
) -> dict[str, Any]:
    """Recover the albedo texture into `staging`; returns the report. `options` are the command's.

    Raises:
        BadInput: the scene cannot be used, or there is nothing to fit to; see `load.load_scene`, `check_uvs.check_uvs`
            and `cast_photos.cast_photos`.
    """
    if options.known and options.unwrap:
        raise BadInput(
            "--known names places in the mesh's own UVs, and --unwrap makes new ones; use one of them."
        )
    if options.uses_field and options.irradiance == "traced":
        raise BadInput(
            "--no-photometric, --equal-bands and --keep-held-out belong to --irradiance field; leave them out."
        )
    _check_components(options)
    preset = settings or PRESETS[options.preset]
    if options.uses_field:
        return recover_field(options, preset, staging, progress)
    return recover_traced(options, preset, staging, progress) if distributed.rank() == 0 else {}


def plan(
    options: RecoverOptions, staging: Path, progress: Progress, settings: Preset | None = None
) -> dict[str, Any]:
    """Decide what `recover` would model and say so, without doing it; returns that. Errors as `recover`."""
    _check_components(options)
    plan_it = plan_field if options.uses_field else plan_traced
    return plan_it(options, settings or PRESETS[options.preset], staging, progress)


def _check_components(options: RecoverOptions) -> None:
    """
    Raises:
        BadInput: components of the light are named that contradict each other, or that the paper's `field` does not have.
    """
    both = sorted(
        {component(each).name for each in options.model}
        & {component(each).name for each in options.leave_out}
    )
    if both:
        raise BadInput(f"--model and --leave-out both name {both[0]}; give it to one of them.")
    if options.uses_field and (options.model or options.leave_out):
        raise BadInput(
            "--model and --leave-out belong to --irradiance traced; the paper's model has no such components."
        )


def average(options: RecoverOptions, staging: Path, progress: Progress) -> dict[str, Any]:
    """Average the photos on the texture, light and all: the baseline. Same files and errors as `recover`."""
    scene, scene3d, size, _, samples = prepare(
        options, None, PRESETS["standard"].texture_size, AVERAGED, staging, progress
    )
    expectation = expect_average(scene, size, samples, progress)
    coverage, mean = empty_coverage(size, size), PhotoAverage(size, size)

    def visit(uv: np.ndarray, footprint: np.ndarray, srgb: np.ndarray) -> None:
        mark(coverage, uv, footprint * size)
        mean.add(uv, linear_from_srgb_array(srgb), 1.0, footprint * size)

    cache = trace_rays(scene, scene3d, visit, staging, progress)
    seen = bake_files(nearest(mean.resolve()), scene3d.mesh, coverage, options.format, staging, progress)
    facts = {"photos": len(scene.frames), "samples": len(cache), "coverage": seen, "texture_size": size}
    return write_report(options, staging, progress, **facts, **expectation)
