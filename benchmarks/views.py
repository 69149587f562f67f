"""What the test cameras see of an albedo texture: the backend's rays and a bilinear lookup, no light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from dante_w.cameras import directions
from dante_w.mesh import Mesh, read_mesh
from dante_w.raycast import Frame3D, Raycaster
from dante_w.scene_folder import Frame, read_scene
from metrics import linear_from_srgb, srgb_from_linear
from pictures import read

RAYS = 3  # along each side of a pixel: edges in the texture are averaged as a renderer does


class Viewer:
    """Looks at a mesh wearing any texture of its UVs."""

    def __init__(self, mesh_file: Path) -> None:
        self.mesh: Mesh = read_mesh(mesh_file)
        self.frame3d = Frame3D.of(self.mesh.vertices)
        self.caster = Raycaster(self.mesh, self.frame3d)

    def view(self, texture: np.ndarray, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """The sRGB picture (H, W, 3) of a linear `texture` in one camera, and where the mesh fills the pixel."""
        width, height = frame.camera.width, frame.camera.height
        origin = self.frame3d.normalise(frame.camera_to_world[:3, 3])
        total, count = np.zeros((width * height, 3)), np.zeros(width * height)
        column, row = np.meshgrid(np.arange(width), np.arange(height))
        for shift in np.ndindex(RAYS, RAYS):
            offset = (np.array(shift) + 0.5) / RAYS
            pixels = np.column_stack([column.ravel(), row.ravel()]) + offset
            rays = directions(frame.camera, pixels) @ frame.camera_to_world[:3, :3].T
            hits = self.caster.cast(origin, rays)
            weights = np.column_stack([1.0 - hits.bary.sum(axis=1), hits.bary])
            assert self.mesh.uvs is not None
            uv = np.einsum("nc,ncd->nd", weights, self.mesh.uvs[hits.face])
            total[hits.ray] += lookup(texture, uv)
            count[hits.ray] += 1.0
        linear = total / np.maximum(count, 1.0)[:, None]
        full = (count == RAYS * RAYS).reshape(height, width)
        return srgb_from_linear(linear).reshape(height, width, 3), full


def lookup(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N, 3) bilinear; texel (i, j) has its centre at u = (i + 0.5) / W, v = 1 - (j + 0.5) / H."""
    height, width, _ = texture.shape
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    i = np.clip(np.stack([left, left + 1]), 0, width - 1)
    j = np.clip(np.stack([top, top + 1]), 0, height - 1)
    upper = texture[j[0], i[0]] * (1.0 - fx) + texture[j[0], i[1]] * fx
    lower = texture[j[1], i[0]] * (1.0 - fx) + texture[j[1], i[1]] * fx
    return upper * (1.0 - fy) + lower * fy


def test_frames(scene: Path) -> list[Frame]:
    """The test cameras of a scene; each frame's image is its true albedo."""
    return read_scene(scene / "transforms_test.json").frames


def linear_texture(result: Path) -> np.ndarray:
    """The albedo of a result folder (or a texture file), linear, top row first."""
    file = result if result.is_file() else next(result.glob("albedo.[pe][nx][gr]"))
    colour, _ = read(file)
    return colour if file.suffix == ".exr" else linear_from_srgb(colour)


def viewer_of(result: Path, scene: Path) -> Viewer:
    """A viewer of the mesh that `result`'s texture belongs to: the scene's, unless new UVs were made."""
    own = result / "mesh.obj"
    return Viewer(own if own.is_file() else scene / "mesh.obj")
