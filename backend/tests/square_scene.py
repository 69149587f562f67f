"""A small scene of its own: a square painted with a known albedo, photographed under known light."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from dante_w.contract.scene_folder import Camera
from dante_w.core.color import srgb_from_linear_array
from dante_w.scene.cameras import directions
from dante_w.scene.images import write_png

CAMERA = Camera("PINHOLE", 48, 36, (60.0, 60.0, 24.0, 18.0))
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def albedo_at(uv: np.ndarray) -> np.ndarray:
    """The painted linear albedo (N, 3): 4 x 4 checks of two colours."""
    check = (np.floor(uv * 4).astype(int).sum(axis=-1) % 2)[..., None]
    return np.where(check == 0, (0.6, 0.3, 0.2), (0.15, 0.3, 0.5))


def pose(x: float, y: float, height: float) -> np.ndarray:
    """A camera at (x, y, height) that looks straight down on the square, z = 0."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, height
    return matrix


def photograph(camera: Camera, camera_to_world: np.ndarray, gain: float, slope: float) -> np.ndarray:
    """sRGB uint8 photo of the square under irradiance gain * (1 + slope * (x - 0.5)); grey around it."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = (
        directions(camera, np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) @ camera_to_world[:3, :3].T
    )
    hit = camera_to_world[:2, 3] - rays[:, :2] * (camera_to_world[2, 3] / rays[:, 2:])
    light = gain * (1.0 + slope * (hit[:, :1] - 0.5))
    linear = np.where(((hit >= 0) & (hit < 1)).all(axis=1)[:, None], albedo_at(hit) * light, 0.2)
    photo = srgb_from_linear_array(linear).clip(0, 1).reshape(camera.height, camera.width, 3)
    return np.rint(photo * 255).astype(np.uint8)


def make_scene(folder: Path, photos: int = 8) -> Path:
    folder.mkdir()
    (folder / "mesh.obj").write_text(SQUARE)
    random = np.random.default_rng(5)
    frames = []
    for index in range(photos):
        camera_to_world = pose(*random.uniform(0.3, 0.7, 2), random.uniform(1.0, 1.6))
        photo = photograph(CAMERA, camera_to_world, random.uniform(0.5, 1.2), random.uniform(-0.8, 0.8))
        write_png(folder / f"{index}.png", photo)
        frames.append({"file_path": f"{index}.png", "transform_matrix": camera_to_world.tolist()})
    fx, fy, cx, cy = CAMERA.params
    intrinsics = {"w": CAMERA.width, "h": CAMERA.height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    return folder
