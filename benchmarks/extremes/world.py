"""The small scene that every extreme is tried on, the product's command on it, and how two textures are compared.

Hills of some hundred triangles, known albedo, and eight photos of 96 x 96 pixels without noise from all around above, under
three lights. Photos are linear float pictures (EXR), so their radiance may be anything. Nothing is random.
"""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from dante_w.commands import cli
from dante_w.contract.scene_folder import Camera, Frame, Scene, write_scene
from dante_w.field.cpu.step import CpuStep
from dante_w.field.fields import FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.field.settings import FieldSettings
from dante_w.presets import PRESETS, Preset
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.cameras import directions
from dante_w.scene.images import read_texture, write_exr
from dante_w.scene.mesh import Mesh, write_obj
from dante_w.traced import pipeline as solve
from measure.synthetic_scene import light_at

QUADS, PHOTOS, LIGHTS, SIDE = 14, 8, 3, 96
FOCAL = 1.4  # in image sides
MIDDLE = np.array([0.5, 0.5, 0.0])
TEXTURE = 128
TRACED: tuple[str, ...] = ("--irradiance", "traced")
FIELD: tuple[str, ...] = ("--irradiance", "field")
_GRADIENTS, _SOLVE, _TEXTURE = CpuStep.gradients, solve.solve_lights, solve.albedo_texture
#: The paper's model with little to fit and few steps.
TINY = replace(
    PRESETS["draft"],
    field=FieldSettings(
        FieldSpec(GridSpec(2, 8, 2, 4, 128, 14), GridSpec(3, 2, 2, 2, 4, 10), hidden=16, embedding=4),
        Schedule(300, 4096, 1e-2),
        Schedule(60, 4096, 2e-3),
        white_light=0.05,
        small_offset=0.2,
    ),
)


@dataclass(frozen=True)
class World:
    """A mesh with UVs, one camera, and per photo its pose (4, 4) and its linear picture (side, side, 3) float32;
    `priors` are linear albedo pictures of the same size, or none."""

    mesh: Mesh
    camera: Camera
    poses: list[np.ndarray]
    photos: list[np.ndarray]
    priors: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True)
class Outcome:
    """What a run ended in: its exit code, the error's sentence, the report, and the linear albedo (S, S, 3) with the
    texels (S, S) that photos saw; None where there is no result. `unsound` names what was not finite on the way."""

    code: int
    message: str
    report: dict[str, Any]
    albedo: np.ndarray | None = None
    seen: np.ndarray | None = None
    unsound: str = ""


def hills(quads: int = QUADS, height: float = 0.12) -> Mesh:
    """Waves over [0, 1]^2 in 2 quads^2 triangles, z up; texture coordinates are x and y."""
    lattice = np.arange(quads + 1) / quads
    x, y = np.meshgrid(lattice, lattice)
    z = height * np.sin(3.0 * np.pi * x) * np.cos(3.0 * np.pi * y)
    corner = np.arange(quads * (quads + 1)).reshape(quads, quads + 1)[:, :-1].ravel()
    a, b, c, d = corner, corner + 1, corner + quads + 2, corner + quads + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return Mesh(vertices, faces, vertices[faces][..., :2].copy())


def looking(eye: np.ndarray, at: np.ndarray = MIDDLE) -> np.ndarray:
    """Camera-to-world (4, 4) of a camera at `eye` (3,) that looks at a point (3,)."""
    backward = (eye - at) / np.linalg.norm(eye - at)
    right = np.cross((0.0, 1.0, 0.0) if abs(backward[2]) > 0.99 else (0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(backward, right), backward, eye])
    return matrix


def around(index: int, count: int = PHOTOS) -> np.ndarray:
    """The pose (4, 4) of one of `count` cameras above."""
    turn, away = 2.0 * np.pi * index / count, (0.35, 0.8)[index % 2]
    return looking(np.array([0.5 + away * np.cos(turn), 0.5 + away * np.sin(turn), 1.35 - 0.5 * away]))


def albedo_at(uv: np.ndarray) -> np.ndarray:
    """Albedo (..., 3) at texture coordinates: broad checks over slow waves, so that it is known at this resolution."""
    u, v = uv[..., 0], uv[..., 1]
    check = (np.floor(5 * u) + np.floor(5 * v)) % 2
    colours = np.where(check[..., None] == 0, (0.55, 0.32, 0.20), (0.16, 0.28, 0.45))
    return colours * (1.0 + 0.2 * np.sin(6 * np.pi * u) * np.sin(4 * np.pi * v))[..., None]


def make(
    mesh: Mesh | None = None,
    poses: Sequence[np.ndarray] | None = None,
    albedo: Any = albedo_at,
    side: int = SIDE,
) -> World:
    """The scene, or the same with another mesh, other poses or another albedo."""
    mesh = hills() if mesh is None else mesh
    poses = [around(index) for index in range(PHOTOS)] if poses is None else list(poses)
    camera = Camera("PINHOLE", side, side, (FOCAL * side, FOCAL * side, side / 2, side / 2))
    shot = [photograph(mesh, camera, own, index, albedo) for index, own in enumerate(poses)]
    return World(mesh, camera, poses, [photo for photo, _ in shot], [])


def photograph(
    mesh: Mesh,
    camera: Camera,
    camera_to_world: np.ndarray,
    index: int,
    albedo: Any = albedo_at,
) -> tuple[np.ndarray, np.ndarray]:
    """Linear pictures (H, W, 3) of a photo and of the albedo in it; black where a pixel misses the mesh."""
    frame3d = Frame3D.around(mesh)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    pixel = np.arange(camera.width * camera.height)
    centres = np.column_stack([pixel % camera.width, pixel // camera.width]) + 0.5
    rays = directions(camera, centres) @ camera_to_world[:3, :3].T
    hits = Raycaster(mesh, frame3d).cast(frame3d.normalise(camera_to_world[:3, 3]), rays)
    normal = normals[hits.face]
    facing = np.einsum("ij,ij->i", normal, rays[hits.ray]) < 0.0
    normal = np.where(facing[:, None], normal, -normal)
    weights = np.column_stack([1.0 - hits.bary.sum(axis=1), hits.bary])
    assert mesh.uvs is not None
    surface = albedo(np.einsum("nc,ncd->nd", weights, mesh.uvs[hits.face]))
    photo, truth = (np.zeros((camera.height * camera.width, 3), np.float32) for _ in range(2))
    photo[hits.ray] = surface * light_at(normal, index % LIGHTS)
    truth[hits.ray] = surface
    shape = (camera.height, camera.width, 3)
    return photo.reshape(shape), truth.reshape(shape)


def with_priors(world: World, albedo: Any = albedo_at) -> World:
    """The scene with its true albedo as every photo's prior."""
    own = [photograph(world.mesh, world.camera, each, k, albedo)[1] for k, each in enumerate(world.poses)]
    return replace(world, priors=own)


def write(world: World, folder: Path) -> Path:
    """Write a scene folder; returns it."""
    folder.mkdir(parents=True)
    frames = []
    for index, (camera_to_world, photo) in enumerate(zip(world.poses, world.photos, strict=True)):
        image = folder / f"{index:03}.exr"
        write_exr(image, photo.astype(np.float32))
        prior = None
        if world.priors:
            prior = folder / f"prior_{index:03}.exr"
            write_exr(prior, world.priors[index])
        frames.append(Frame(image, world.camera, camera_to_world, albedo=prior))
    write_obj(folder / "mesh.obj", world.mesh)
    write_scene(folder, Scene(folder / "transforms.json", folder / "mesh.obj", frames))
    return folder


def recover(scene: Path, *options: str, preset: Preset = TINY, size: int = TEXTURE) -> Outcome:
    """Run `dante-w recover` here and now on a scene folder; `preset` stands in for `draft`."""
    out = scene.with_name(scene.name + "-out")
    command = ["recover", str(scene), "--out", str(out), "--preset", "draft", "--format", "exr", "--json"]
    command += ["--texture-size", str(size), *options]
    lines, log = io.StringIO(), io.StringIO()
    said = contextlib.redirect_stdout(lines), contextlib.redirect_stderr(log)
    with (
        _signals_kept(),
        _watched() as unsound,
        said[0],
        said[1],
    ):
        code = cli.main(command, settings=preset)
    return replace(outcome(code, lines.getvalue(), out), unsound=", ".join(unsound))


@contextlib.contextmanager
def _watched() -> Iterator[dict[str, None]]:
    """Look at every loss and gradient of the paper's model and at all that traced light hands on; names of what is not
    finite, once each."""
    found: dict[str, None] = {}

    def look(name: str, *values: Any) -> None:
        for value in values:
            if not bool(np.isfinite(np.asarray(value)).all()):
                found[name] = None

    def gradients(self: CpuStep, samples: Any) -> Any:
        loss, by_name = _GRADIENTS(self, samples)
        look("loss", loss)
        for name, gradient in by_name.items():
            look(f"gradient of {name}", gradient)
        return loss, by_name

    def solved(*arguments: Any, **keywords: Any) -> Any:
        lights = _SOLVE(*arguments, **keywords)
        look("lights", lights.radiance, lights.log_exposure, lights.bounce, lights.albedo)
        return lights

    def texture(*arguments: Any, **keywords: Any) -> Any:
        made = _TEXTURE(*arguments, **keywords)
        look("texture", made)
        return made

    with contextlib.ExitStack() as patches:
        patches.enter_context(mock.patch.object(CpuStep, "gradients", gradients))
        patches.enter_context(mock.patch.object(solve, "solve_lights", solved))
        patches.enter_context(mock.patch.object(solve, "albedo_texture", texture))
        yield found


def recover_apart(scene: Path, *options: str, size: int = TEXTURE) -> Outcome:
    """The same in a process of its own with the true presets, which tells its own peak memory."""
    out = scene.with_name(scene.name + "-out")
    command = [sys.executable, "-m", "dante_w", "recover", str(scene), "--out", str(out), "--preset", "draft"]
    command += ["--format", "exr", "--json", "--texture-size", str(size), *options]
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    return outcome(done.returncode, done.stdout, out)


def outcome(code: int, lines: str, out: Path) -> Outcome:
    """What a command with `--json` said and left in its folder."""
    last = json.loads(lines.splitlines()[-1])
    if code != 0:
        return Outcome(code, last.get("message", ""), {})
    seen = read_texture(out / "coverage.png")[..., 0] > 0.5
    return Outcome(0, "", last["report"], read_texture(out / "albedo.exr"), seen)


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """The command takes SIGINT and SIGTERM for itself."""
    before = {name: signal.getsignal(name) for name in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
