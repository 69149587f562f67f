"""Scenes spoilt in the ways that real photos are: the same seed gives the same spoilt scene.

A spoilt scene is a scene folder: `transforms.json`, photos without alpha, a mask of each photo's object, and the mesh that the
method is given. Test views and the true mesh stay in the scene that it was made from. Colours are linear Rec.709.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from dante_w.contract.scene_folder import Frame, Scene, read_scene, write_scene
from dante_w.rays.raycast import Frame3D
from dante_w.scene.images import read_photo, write_png
from dante_w.scene.mesh import Mesh, read_mesh, write_obj
from measure.metrics import linear_from_srgb, srgb_from_linear
from measure.pictures import write
from measure.views import Viewer

CLIPPED = 0.1  # part of the object's pixels that clip
DARKER = 16.0  # four stops
PEOPLE, COVERED = (
    0.25,
    (0.1, 0.2),
)  # part of the photos with somebody in them, part of the object that they hide
GLINTS, SHARP = 3, 60.0  # lights that make highlights; the power of their cosine
ROUGH, SMOOTH, WAVES = (
    0.001,
    0.0028,
    6,
)  # standard deviations of vertices in sides of the mesh, of noise and of waves
JITTER = 1.0  # pixels, standard deviation

#: What a spoil makes of a photo: (linear (H, W, 3), foreground (H, W), its index, the generator) to linear (H, W, 3).
Change = Callable[[np.ndarray, np.ndarray, int, np.random.Generator], np.ndarray]


def clipped(linear: np.ndarray, foreground: np.ndarray, _: int, random: np.random.Generator) -> np.ndarray:
    """Exposed so that a tenth of the object clips."""
    return linear / np.quantile(linear[foreground].max(axis=1), 1.0 - CLIPPED)


def dark(linear: np.ndarray, foreground: np.ndarray, _: int, random: np.random.Generator) -> np.ndarray:
    """Four stops too dark."""
    return linear / DARKER


def people(linear: np.ndarray, foreground: np.ndarray, _: int, random: np.random.Generator) -> np.ndarray:
    """Somebody in stripes walks through some of the photos."""
    here = random.random() < PEOPLE
    row, column = np.indices(foreground.shape)
    middle = random.choice(np.argwhere(foreground))
    y, x = row - middle[0], column - middle[1]
    stretch, lean, phase = random.uniform(1.5, 3.0), random.uniform(-0.4, 0.4), random.uniform(0.0, 6.3)
    away = np.hypot(y / stretch, x - lean * y) * (1.0 + 0.2 * np.sin(3.0 * np.arctan2(y, x) + phase))
    blob = away <= np.quantile(away[foreground], random.uniform(*COVERED))
    brightness = np.median(linear[foreground].mean(axis=1)) * random.uniform(0.5, 2.5)
    cloth = brightness * random.uniform(0.3, 1.7, (2, 3))
    stripe = np.sin(y * random.uniform(0.2, 0.8) + 0.3 * x) > 0.0
    return np.where((blob & here)[..., None], np.where(stripe[..., None], cloth[0], cloth[1]), linear)


def highlights(viewer: Viewer, eyes: np.ndarray, lights: np.ndarray) -> Change:
    """White glints of `lights` (J, 3), unit vectors, that move over the object with the view; `eyes` (K, 3) are the
    cameras' centres in the mesh's unit cube."""

    def change(
        linear: np.ndarray, foreground: np.ndarray, index: int, random: np.random.Generator
    ) -> np.ndarray:
        surface = viewer.surface(index)
        eye = eyes[index] - surface.position
        eye /= np.linalg.norm(eye, axis=1, keepdims=True)
        glint = np.zeros(foreground.size)
        for light in lights:
            half = eye + light
            half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
            cosine = np.maximum(np.einsum("ij,ij->i", half, surface.normal), 0.0)
            glint[surface.pixel] += cosine**SHARP * (surface.normal @ light > 0.0)
        bright = np.quantile(linear[foreground].mean(axis=1), 0.95)
        return linear + bright * glint.reshape(*foreground.shape, 1)

    return change


def unmasked(linear: np.ndarray, foreground: np.ndarray, _: int, random: np.random.Generator) -> np.ndarray:
    """A background of two colours, which no mask keeps apart from the object; a pixel at the outline is half of each."""
    brightness = np.median(linear[foreground].mean(axis=1))
    colours = brightness * random.uniform(0.2, 3.0, (2, 3))
    row, column = np.indices(foreground.shape)
    stripe = np.sin((row + column * random.uniform(-1.0, 1.0)) * random.uniform(0.02, 0.06)) > 0.0
    solid = np.pad(foreground, 1, mode="edge")
    inner = solid[1:-1, 1:-1] & solid[2:, 1:-1] & solid[:-2, 1:-1] & solid[1:-1, 2:] & solid[1:-1, :-2]
    share = 0.5 * foreground[..., None] + 0.5 * inner[..., None]
    return share * linear + (1.0 - share) * np.where(stripe[..., None], colours[0], colours[1])


def displaced(mesh: Mesh, random: np.random.Generator) -> Mesh:
    """Vertices off by waves and by noise, about 0.3% of the mesh's size in all; UVs as they were."""
    side = float(np.ptp(mesh.vertices, axis=0).max())
    unit = (mesh.vertices - mesh.vertices.min(axis=0)) / side
    waves = random.normal(0.0, 12.0, (WAVES, 3))
    phases = random.uniform(0.0, 2.0 * np.pi, (WAVES, 3))
    smooth = sum(np.sin((unit @ wave)[:, None] + phase) for wave, phase in zip(waves, phases, strict=True))
    off = SMOOTH * np.sqrt(2.0 / WAVES) / np.sqrt(3.0) * smooth
    off += random.normal(0.0, ROUGH / np.sqrt(3.0), unit.shape)
    return replace(mesh, vertices=mesh.vertices + side * off)


def jittered(frame: Frame, random: np.random.Generator) -> Frame:
    """The camera turned so that its picture moves by about a pixel."""
    angle = random.normal(0.0, JITTER / frame.camera.params[0], 3)
    x, y, z = angle
    turn = np.eye(4)
    turn[:3, :3] += np.array(
        [(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)]
    )  # of a thousandth: as good as a rotation
    turn[:3, :3] = np.linalg.qr(turn[:3, :3])[0] * np.sign(np.diag(np.linalg.qr(turn[:3, :3])[1]))
    return replace(frame, camera_to_world=frame.camera_to_world @ turn)


SPOILS = ("clean", "clipped", "dark", "people", "highlights", "mesh", "poses", "unmasked")


def spoilt(scene: Path, spoil: str, folder: Path, seed: int) -> Path:
    """A copy of a scene with test views, spoilt in one of `SPOILS` ways, in `folder` (made anew); returns `folder`."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    random = np.random.default_rng([seed, SPOILS.index(spoil)])
    frames = read_scene(scene / "transforms_train.json").frames
    mesh = read_mesh(scene / "mesh.obj")
    change = change_of(spoil, scene, frames, random)
    copies = []
    for index, frame in enumerate(frames):
        photo = read_photo(frame.image, frame.mask)
        linear = linear_from_srgb(photo.srgb)
        encoded = srgb_from_linear(change(linear, photo.foreground, index, random)).clip(0.0, 1.0)
        name = f"{index:03}.png"
        write(folder / "photos" / name, encoded)
        (folder / "masks").mkdir(exist_ok=True)
        write_png(folder / "masks" / name, photo.foreground.astype(np.uint8) * 255)
        copy = replace(frame, image=folder / "photos" / name, mask=folder / "masks" / name)
        if spoil == "unmasked":
            copy = replace(copy, mask=None)
        copies.append(jittered(copy, random) if spoil in ("poses", "unmasked") else copy)
    write_obj(folder / "mesh.obj", displaced(mesh, random) if spoil == "mesh" else mesh)
    write_scene(folder, Scene(folder / "transforms.json", folder / "mesh.obj", copies))
    return folder


def change_of(spoil: str, scene: Path, frames: list[Frame], random: np.random.Generator) -> Change:
    """What a spoil does to photos."""
    if spoil == "highlights":
        lights = random.normal(size=(GLINTS, 3))
        lights /= np.linalg.norm(lights, axis=1, keepdims=True)
        lights[:, 2] = np.abs(lights[:, 2])
        centres = np.stack([frame.camera_to_world[:3, 3] for frame in frames])
        eyes = Frame3D.bounding(read_mesh(scene / "mesh.obj").vertices).normalise(centres)
        return highlights(Viewer(scene / "mesh.obj", frames), eyes, lights)
    changes: dict[str, Change] = {"clipped": clipped, "dark": dark, "people": people, "unmasked": unmasked}
    return changes.get(spoil, lambda linear, *_: linear)
