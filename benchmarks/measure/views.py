"""What cameras see of an albedo texture: the backend's rays and a bilinear lookup, no light."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dante_w.contract.scene_folder import Camera, Frame, read_scene
from dante_w.rays.raycast import Frame3D, Hits, Raycaster
from dante_w.scene.cameras import directions
from dante_w.scene.mesh import read_mesh
from measure.metrics import linear_from_srgb, srgb_from_linear
from measure.pictures import read

RAYS = 3  # along each side of a pixel: edges in the texture are averaged as a renderer does


class Surface(NamedTuple):
    """What lies behind the pixels of one picture whose centres meet the mesh.

    pixel (N,) int64 in raster order; position (N, 3) float64 in the mesh's unit cube (`Frame3D`); normal (N, 3)
    float64, of the flat face, unit length, turned towards the camera.
    """

    pixel: np.ndarray
    position: np.ndarray
    normal: np.ndarray


class Viewer:
    """Shows any texture of a mesh's UVs in some posed cameras, and the surface that they see.

    `truth` are the frames' own pictures: with the frames of transforms_test.json, the true albedo. The rays of
    a view (16 bytes each, 9 a pixel) stay in memory for the next texture unless `keep` is false.
    """

    def __init__(self, mesh_file: Path, frames: Sequence[Frame], keep: bool = True) -> None:
        self.frames = list(frames)
        self.truth = [frame.image for frame in self.frames]
        self._mesh = read_mesh(mesh_file)
        if self._mesh.uvs is None:
            raise ValueError(f"{mesh_file} has no UVs")
        self._frame3d = Frame3D.bounding(self._mesh.vertices)
        self._caster = Raycaster(self._mesh, self._frame3d)
        self._keep = keep
        self._seen: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def __len__(self) -> int:
        return len(self.frames)

    def view(self, texture: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
        """The sRGB picture (H, W, 3) of a linear `texture` in one camera, and where the mesh fills the pixel."""
        pixel, uv = self._seen[index] if index in self._seen else self._trace(index)
        if self._keep:
            self._seen[index] = pixel, uv
        camera = self.frames[index].camera
        size = camera.width * camera.height
        count = np.bincount(pixel, minlength=size)
        colours = lookup(texture, uv)
        total = np.stack([np.bincount(pixel, channel, size) for channel in colours.T], axis=-1)
        picture = srgb_from_linear(total / np.maximum(count, 1)[:, None])
        shape = (camera.height, camera.width)
        return picture.reshape(*shape, 3), (count == RAYS * RAYS).reshape(shape)

    def surface(self, index: int) -> Surface:
        """The surface at the pixel centres of one camera."""
        frame = self.frames[index]
        hits = self._cast(frame, pixel_rays(frame.camera, 1))
        corners = self._frame3d.normalise(self._mesh.vertices[self._mesh.faces[hits.face]])
        position = np.einsum("nc,ncd->nd", corner_weights(hits), corners)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        to_camera = self._frame3d.normalise(frame.camera_to_world[:3, 3]) - position
        facing = np.einsum("nd,nd->n", normal, to_camera)
        return Surface(hits.ray, position, np.where(facing[:, None] < 0.0, -normal, normal))

    def _trace(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Pixel (N,) and texture coordinate (N, 2) of every ray that meets the mesh."""
        frame = self.frames[index]
        hits = self._cast(frame, pixel_rays(frame.camera, RAYS))
        uv = np.einsum("nc,ncd->nd", corner_weights(hits), self._mesh.uvs[hits.face])
        return (hits.ray // (RAYS * RAYS)).astype(np.int32), uv.astype(np.float32)

    def _cast(self, frame: Frame, rays: np.ndarray) -> Hits:
        """First hits of `rays` (N, 3), directions in the camera space of `frame`."""
        origin = self._frame3d.normalise(frame.camera_to_world[:3, 3])
        return self._caster.cast(origin, rays @ frame.camera_to_world[:3, :3].T)


def corner_weights(hits: Hits) -> np.ndarray:
    """(N, 3) barycentric weights of the three corners of each hit's face."""
    return np.column_stack([1.0 - hits.bary.sum(axis=1), hits.bary])


def pixel_rays(camera: Camera, side: int) -> np.ndarray:
    """(H W side^2, 3) directions in camera space, `side` x `side` a pixel, pixel after pixel in raster order."""
    offsets = (np.arange(side) + 0.5) / side
    row, column, dy, dx = np.meshgrid(
        np.arange(camera.height), np.arange(camera.width), offsets, offsets, indexing="ij"
    )
    return directions(camera, np.column_stack([(column + dx).ravel(), (row + dy).ravel()]))


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


def linear_texture(result: Path) -> np.ndarray:
    """The albedo of a result folder (or a texture file), linear, top row first."""
    file = result if result.is_file() else next(result.glob("albedo.[pe][nx][gr]"))
    colour, _ = read(file)
    return colour if file.suffix == ".exr" else linear_from_srgb(colour)


def viewer_of(result: Path, scene: Path) -> Viewer:
    """A viewer of the mesh that `result`'s texture belongs to: the scene's, unless new UVs were made."""
    own = result / "mesh.obj"
    return _viewer(own if own.is_file() else scene / "mesh.obj", scene)


@lru_cache(maxsize=4)  # objects, which `tradeoff` takes in turn
def _viewer(mesh_file: Path, scene: Path) -> Viewer:
    return Viewer(mesh_file, read_scene(scene / "transforms_test.json").frames)
