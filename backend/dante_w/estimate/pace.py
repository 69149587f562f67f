"""How fast this machine is, from the run itself in small.

Every kind of work that is to come is done for a moment with its own functions, on this device, this mesh and some of
these photos. So there are no constants of a machine. The first run after installing compiles kernels; those that the
rest needs are compiled here, before anything is timed.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from dante_w.contract.scene_folder import Frame
from dante_w.field.fields import FieldModel
from dante_w.field.inference import psnr
from dante_w.field.optimise import Problem, Schedule, fit
from dante_w.field.pipeline import FieldRun, albedo_lookup
from dante_w.rays.cast_photos import footprints, surface
from dante_w.rays.ray_cache import RayCache, Surface
from dante_w.rays.raycast import Raycaster
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.cameras import directions
from dante_w.scene.images import Photo, read_photo, write_exr, write_png
from dante_w.scene.mesh import Mesh
from dante_w.texture.bake import Texels, bake
from dante_w.texture.coverage import empty_coverage, mark
from dante_w.texture.encoding import encode_rows

T = TypeVar("T")

#: Evenly spread photos are read until they have this many pixels; one at least.
READ_PIXELS = 1 << 21
#: Rays cast at least, if those photos have as many, and at most from one photo.
RAYS = 1 << 19
#: Steps timed at most, after one that loads kernels and makes the optimiser's state; no more begin after these seconds.
STEPS, STEP_SECONDS = 5, 0.4
#: Samples re-rendered.
RENDERED = 1 << 16
#: Texels a side of the texture baked and written, and of one before it that only loads kernels.
SIDE, WARM_SIDE = 512, 64
#: Work on a ray that hits (weights, colours, coverage) per work on casting it: with it the column `rays` of
#: `bench time_estimate` is right on objects and on fountain-P11. Both are array code, so it holds on any machine.
HIT_WORK = 0.5
#: Noise on the linear texture that is written: as long to compress as the albedo of the five shared scenes.
GRAIN = 0.02


@dataclass(frozen=True)
class Texture:
    """The texture to come: texels a `side`, and the `kind` of its numbers; see `bake.bake`."""

    side: int
    kind: type


@dataclass(frozen=True)
class Pace:
    """Seconds on this machine: `read` a pixel of a photo; prepare the `mesh` for rays; trace a `ray`; one `step` of the
    fit; one `photo_step` on held-out photos; `render` a sample; `bake` and `write` a texel. `foreground` is the
    share of pixels that are traced."""

    read: float
    mesh: float
    ray: float
    foreground: float
    bake: float
    write: float
    step: float = 0.0
    photo_step: float = 0.0
    render: float = 0.0


@dataclass(frozen=True)
class Sample:
    """Some photos' pixels: `cache`, what they see by `caster`; the seconds that it takes to read a pixel, to prepare the mesh
    and to trace a `ray`, the share of pixels in the `foreground`, and that of rays which hit the mesh (`hit`)."""

    cache: RayCache
    caster: Raycaster
    read: float
    mesh: float
    ray: float
    foreground: float
    hit: float


def take(frames: list[Frame], scene3d: Scene3D) -> Sample:
    """Read a few of the photos, evenly spread, and cast their rays.

    Raises:
        BadInput: a photo cannot be read.
    """
    pixels = sum(map(_pixels, frames))
    count = min(max(READ_PIXELS * len(frames) // pixels, 1), len(frames))
    chosen = [frames[(2 * i + 1) * len(frames) // (2 * count)] for i in range(count)]
    photos, reading = timed(lambda: [_read(frame) for frame in chosen])
    read = sum(map(_pixels, chosen))
    corners, preparing = timed(lambda: surface(scene3d))
    cache, ray, hit = _cast(chosen, photos, scene3d, corners)
    foreground = sum(int(photo.foreground.sum()) for photo in photos) / read
    return Sample(cache, scene3d.caster, reading / read, preparing, ray, foreground, hit)


def measure(sample: Sample, mesh: Mesh, texture: Texture, folder: Path, run: FieldRun | None = None) -> Pace:
    """Do a little of what follows and time it, in about a second once kernels are loaded.

    Args:
        folder: for a file, which is removed.
        run: of the paper's model; left out, the texture needs no fit.
    """
    fit_seconds, texels = _fit(sample.cache, run, texture.side) if run else ((0.0, 0.0, 0.0), _grey)
    small = replace(texture, side=min(texture.side, SIDE))
    return Pace(
        sample.read,
        sample.mesh,
        sample.ray,
        sample.foreground,
        _bake(texels, mesh, small) / small.side**2,
        _write(folder, small) / small.side**2,
        *fit_seconds,
    )


def _cast(
    frames: list[Frame], photos: list[Photo], scene3d: Scene3D, corners: Surface
) -> tuple[RayCache, float, float]:
    """Cast the photos' pixels, photo by photo as the run does; returns what they hit, the seconds a ray takes, and the
    share of rays that hit anything."""
    faces, barys, colours, spans, cast, seconds = [], [], [], [], 0, 0.0
    for frame, photo in zip(frames, photos, strict=True):
        if cast >= RAYS:
            break
        foreground = np.flatnonzero(photo.foreground)
        first = max(len(foreground) - RAYS, 0) // 2
        pixel = foreground[first : first + RAYS]
        began = time.perf_counter()
        centres = np.column_stack([pixel % frame.camera.width, pixel // frame.camera.width]) + 0.5
        rays = directions(frame.camera, centres) @ frame.camera_to_world[:3, :3].T
        hits = scene3d.caster.cast(scene3d.frame.normalise(frame.camera_to_world[:3, 3]), rays)
        seconds += (time.perf_counter() - began) * (1.0 + HIT_WORK * len(hits.ray) / max(len(rays), 1))
        cast += len(rays)
        faces.append(hits.face)
        barys.append(hits.bary)
        colours.append(photo.srgb.reshape(-1, 3)[pixel[hits.ray]])
        spans.append(footprints(frame, rays[hits.ray], hits, scene3d)[1])
    hit = sum(map(len, faces)) / max(cast, 1)
    if not any(map(len, faces)):  # the run itself will say so if nothing is ever hit
        faces[0], barys[0], colours[0] = np.zeros(1, np.int32), np.zeros((1, 2)), np.full((1, 3), 0.5)
        spans[0] = np.ones(1)
    colour = np.concatenate(colours).clip(0.0, 1.0).astype(np.float16)
    bary = np.rint(np.concatenate(barys) * 65535.0).astype(np.uint16)
    starts = np.cumsum([0, *map(len, faces)]).astype(np.int64)
    prior = np.pad(colour, [(0, 0), (0, 1)]) if any(frame.albedo for frame in frames) else None
    face, footprint = np.concatenate(faces).astype(np.int32), np.concatenate(spans).astype(np.float16)
    cache = RayCache(corners, starts, face, bary, colour, prior, footprint)
    return cache, seconds / max(cast, 1), hit


def _fit(cache: RayCache, run: FieldRun, texture_size: int) -> tuple[tuple[float, float, float], Texels]:
    """Seconds of a step, of a step on held-out photos, and of rendering a sample; and the albedo of a new model."""
    with torch.random.fork_rng(devices=[]):  # the run's own random numbers stay as they are
        spec = run.settings.spec_for(texture_size, cache)
        model = FieldModel(spec, len(cache.starts) - 1).to(run.device)
    ranges = np.array([[0, len(cache)]])
    ends: list[float] = []

    def step_done(*_: Any) -> None:
        float(model.offset.detach().sum())  # waits for the device
        ends.append(time.perf_counter())
        if len(ends) > 1 and ends[-1] - ends[0] > STEP_SECONDS:
            raise _EnoughError

    def step_seconds(batch: int, parameters: list[torch.nn.Parameter] | None) -> float:
        ends.clear()
        with contextlib.suppress(_EnoughError):
            problem = Problem(model, cache, ranges, run.terms, parameters)
            fit(problem, Schedule(1 + STEPS, batch), 0, step_done, shared=False)
        return float(np.median(np.diff(ends)))

    held_out = run.settings.held_out.schedule
    seconds = (
        step_seconds(run.settings.schedule.batch, None),
        step_seconds(held_out.batch, model.photo_parameters()),
    )
    rendered = np.arange(RENDERED) % len(cache)
    _, rendering = timed(lambda: psnr(model, cache, rendered))
    return (*seconds, rendering / RENDERED), albedo_lookup(model, torch.ones(3))


class _EnoughError(Exception):
    """Ends a fit that was only to be timed."""


def _grey(uv: np.ndarray) -> np.ndarray:
    return np.full((len(uv), 3), 0.5, np.float32)


def _bake(texels: Texels, mesh: Mesh, texture: Texture) -> float:
    """Seconds to bake a texture whose every texel was seen."""

    def once(side: int) -> float:
        assert mesh.uvs is not None
        coverage = empty_coverage(side, side)
        mark(coverage, np.array([[0.5, 0.5]]), 2.0 * side)
        out: np.ndarray = np.empty((side, side, 3), texture.kind)
        marks = np.empty((side, side), np.uint8)
        began = time.perf_counter()
        bake(texels, mesh.uvs, coverage, out, marks)
        return time.perf_counter() - began

    once(min(texture.side, WARM_SIDE))
    return once(texture.side)


def _write(folder: Path, texture: Texture) -> float:
    """Seconds to write a texture."""
    noise = GRAIN * np.random.default_rng(0).standard_normal((texture.side, texture.side, 3))
    texels = encode_rows(0.3 + noise, np.dtype(texture.kind))
    write, name = (write_exr, "pace.exr") if texels.dtype.kind == "f" else (write_png, "pace.png")
    file = folder / name
    _, seconds = timed(lambda: write(file, texels))
    file.unlink()
    return seconds


def _read(frame: Frame) -> Photo:
    photo = read_photo(frame.image, frame.mask)
    if frame.albedo is not None:
        read_photo(frame.albedo)
    return photo


def _pixels(frame: Frame) -> int:
    return frame.camera.width * frame.camera.height


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What `work` returns, and the seconds it took."""
    began = time.perf_counter()
    return work(), time.perf_counter() - began
