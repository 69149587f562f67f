"""Stages that every command shares: the scene, the rays, the files."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from dante_w import __version__
from dante_w.commands.doctor import library_versions
from dante_w.commands.plan_report import texture_side
from dante_w.contract.errors import BadInput
from dante_w.contract.known_colour import KnownColour
from dante_w.contract.protocol import Decision, Planned
from dante_w.contract.report import COVERAGE, MESH, REPORT, albedo_file
from dante_w.contract.scene_folder import Frame, Scene
from dante_w.estimate.expectation import Expectation
from dante_w.estimate.memory import cache_bytes, resident, room
from dante_w.estimate.seconds import Work, measure, predict, since_start
from dante_w.options import RecoverOptions
from dante_w.rays.cast_photos import CAST, CastSettings, cast_photos
from dante_w.rays.footprint import glance
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.device import peak_memory
from dante_w.run.progress import Progress
from dante_w.run.result_files import names_in, refuse_inputs
from dante_w.scene.images import write_exr, write_png
from dante_w.scene.load import load_scene
from dante_w.scene.mesh import Mesh, write_obj
from dante_w.texture.bake import Texels, bake
from dante_w.texture.check_uvs import check_uvs
from dante_w.texture.coverage import Coverage, empty_coverage, mark
from dante_w.texture.unwrap import unwrap
from dante_w.traced.pixel_weights import USUAL

TEXEL_TYPES = {"png": np.uint8, "png16": np.uint16, "exr": np.float16}


def prepare(
    options: RecoverOptions, priors: Path | None, most: int, texel: int, staging: Path, progress: Progress
) -> tuple[Scene, Scene3D, int, Decision, int]:
    """The scene, its mesh with UVs ready for rays, the texels along a side of the texture, at `most` so many unless the user wants more,
    why so many, and about how many pixels see the mesh. `texel`: bytes that one takes while the texture is made."""
    scene, mesh = load_scene(options.scene, options.mesh, options.images, priors)
    name = options.mesh or scene.mesh or scene.source
    if options.out is not None:
        refuse_inputs(options.out, files_read(scene, name))
    if options.unwrap:
        mesh = dataclasses.replace(mesh, uvs=None)
    else:
        check_uvs(mesh.uvs, name)
    scene3d = Scene3D.build(mesh)
    seen = glance(scene3d, scene.frames)
    samples = round(seen.share * pixels(scene.frames))
    held = resident() + cache_bytes(samples, any(frame.albedo for frame in scene.frames))
    size, decision = texture_side(seen.footprint, most, options.texture_size, texel, room() - held)
    progress.update("scene", 1, 1)
    if options.unwrap:
        mesh = unwrap(mesh, lambda done: progress.update("unwrap", done, 1.0), size)
        write_obj(staging / MESH, mesh)
        check_uvs(mesh.uvs, name)
        assert mesh.uvs is not None
        scene3d = scene3d.with_uvs(mesh.uvs)
    return scene, scene3d, size, decision, samples


def files_read(scene: Scene, mesh: Path) -> list[Path]:
    """The files that a run reads."""
    images = [path for frame in scene.frames for path in (frame.image, frame.mask, frame.albedo) if path]
    return [scene.source, mesh, *images]


def say_plan(options: RecoverOptions, decisions: list[Decision], progress: Progress) -> None:
    """Say what is modelled, and why; a plan alone is what standard output is for."""
    progress.close()
    if progress.as_json:
        progress.say(Planned(tuple(decisions)))
        return
    for line in decisions:
        out = sys.stdout if options.out is None else sys.stderr
        print(f"{line.what}: {line.choice} ({line.reason}; {line.costs})", file=out, flush=True)


def expect_average(scene: Scene, size: int, samples: int, progress: Progress) -> dict[str, Any]:
    """Begin a run that averages photos, with what its stages will take; returns facts for the report."""
    work, probe = Work(pixels(scene.frames), samples, size**2), measure()
    begin(progress, predict(work, "average", probe))
    return {"work": dataclasses.asdict(work), "probe": dataclasses.asdict(probe)}


def begin(progress: Progress, to_come: dict[str, float]) -> None:
    """End the stages that only prepare, count the time before them as one more, and expect the others."""
    progress.close()
    start = max(since_start() - sum(progress.seconds.values()), 0.0)
    progress.seconds = {"start": round(start, 3), **progress.seconds}
    progress.expect(to_come)


def say_expected(
    options: RecoverOptions, expected: Expectation, priors: bool, progress: Progress
) -> dict[str, Any]:
    """Say what the run will take and what its preset reached elsewhere; returns that for the report."""
    if progress.as_json:
        progress.say(expected.message())
    else:
        print(expected.sentence(options.preset, priors), file=sys.stderr, flush=True)
    return expected.as_dict()


def pixels(frames: Iterable[Frame]) -> int:
    return sum(frame.camera.width * frame.camera.height for frame in frames)


def trace_rays(
    scene: Scene,
    scene3d: Scene3D,
    visit: Callable[[np.ndarray, np.ndarray, np.ndarray], None],
    staging: Path,
    progress: Progress,
    settings: CastSettings = CAST,
) -> RayCache:
    spill = staging / "rays"
    spill.mkdir()
    progress.update("rays", 0.0, 1.0)
    return cast_photos(
        scene3d, scene.frames, visit, lambda done: progress.update("rays", done, 1.0), spill, settings
    )


@dataclasses.dataclass(frozen=True)
class Seen:
    """What the photos see of the mesh, and of the texture."""

    cache: RayCache
    coverage: Coverage


def look(
    scene: Scene,
    scene3d: Scene3D,
    size: int,
    kept: Checkpoints | None,
    staging: Path,
    progress: Progress,
    settings: CastSettings = CAST,
) -> Seen:
    """Trace the rays and note which of size x size texels they meet, unless that was kept."""

    def work() -> Seen:
        coverage = empty_coverage(size, size)

        def visit(uv: np.ndarray, footprint: np.ndarray, _: np.ndarray) -> None:
            mark(coverage, uv, footprint * size)

        return Seen(trace_rays(scene, scene3d, visit, staging, progress, settings), coverage)

    return kept.done("rays", Seen, work) if kept else work()


def check_exposed(scene: Scene, cache: RayCache) -> None:
    """Make sure that some photo shows more of the mesh than black and white.

    Raises:
        BadInput: none does.
    """
    for first, end in zip(cache.starts[:-1], cache.starts[1:], strict=True):
        colour = np.asarray(cache.colour[first:end], np.float32)
        if ((colour.max(axis=1, initial=0.0) > 0.0) & (colour < USUAL.clipped_from).any(axis=1)).any():
            return
    raise BadInput(
        f"{scene.frames[0].image.parent}: all photos are black or overexposed where they show the mesh; use others."
    )


def nearest(texture: np.ndarray) -> Texels:
    """The texels of a square texture that is there already."""
    size = len(texture)

    def texels(uv: np.ndarray) -> np.ndarray:
        column = (uv[:, 0] * size).astype(np.int64).clip(0, size - 1)
        row = ((1.0 - uv[:, 1]) * size).astype(np.int64).clip(0, size - 1)
        return np.minimum(texture[row, column], 1.0)

    return texels


def bake_files(
    texels: Texels, mesh: Mesh, coverage: Coverage, kind: str, staging: Path, progress: Progress
) -> float:
    """Write the albedo and coverage images; returns the fraction of the texels on the mesh that were seen."""
    assert mesh.uvs is not None
    shape = (coverage.height, coverage.width)
    files = {"albedo.raw": (*shape, 3), "coverage.raw": shape}
    kinds = {"albedo.raw": TEXEL_TYPES[kind], "coverage.raw": np.uint8}
    out, marks = (_mapped(staging / name, kinds[name], files[name]) for name in files)
    seen = bake(texels, mesh.uvs, coverage, out, marks, lambda done: progress.update("bake", done, 1.0))
    progress.update("write", 0, 1)
    if kind == "exr":
        write_exr(staging / albedo_file(kind), out)
    else:
        write_png(staging / albedo_file(kind), out)
    write_png(staging / COVERAGE, marks)
    del out, marks
    for name in files:
        (staging / name).unlink()
    progress.update("write", 1, 1)
    return seen


def _mapped(path: Path, kind: type, shape: tuple[int, ...]) -> np.ndarray:
    """A new file as an array. Its room is taken at once: a mapped file that meets the end of the disk kills the process."""
    size = math.prod(shape) * np.dtype(kind).itemsize
    with open(path, "wb") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
    return np.memmap(path, kind, "r+", shape=shape)


def write_report(options: RecoverOptions, staging: Path, progress: Progress, **facts: Any) -> dict[str, Any]:
    """Write report.json; returns its content."""
    progress.close()
    report = {
        "dante_w": __version__,
        "settings": {name: _plain(v) for name, v in vars(options).items()},
        **facts,
        "files": [*names_in(staging), REPORT],
        "seconds": progress.seconds,
        "peak_memory_bytes": peak_memory(),
        "versions": library_versions(),
    }
    (staging / REPORT).write_text(json.dumps(report, indent=1), encoding="utf-8")
    return report


def _plain(value: Any) -> Any:
    """An option as JSON has it."""
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return (
        dataclasses.asdict(value)
        if isinstance(value, KnownColour)
        else str(value)
        if isinstance(value, Path)
        else value
    )
