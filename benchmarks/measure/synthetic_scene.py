"""A scene made in moments, as large as one likes: a bumpy sphere of known albedo, photographed under simple light.

No Cycles and no files from elsewhere: photos are made with the backend's own rays, samples without any. All colours are linear
Rec.709 unless they are called sRGB. The sphere's UVs are longitude and latitude.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from dante_w.contract.scene_folder import Camera, Frame, Scene, write_scene
from dante_w.rays.ray_cache import Samples
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.cameras import directions
from dante_w.scene.mesh import Mesh, write_obj
from measure.metrics import srgb_from_linear
from measure.pictures import write

AMBIENT = 0.3  # light that reaches every point, beside the one from a direction
BACKGROUND = 0.5  # sRGB, where a photo misses the sphere
DISTANCE = 3.2  # of the cameras from the centre, in the sphere's radii
FOCAL = 1.45  # in image sides: the sphere fills the height of a photo
PIXELS_AT_ONCE = 1 << 20


def albedo_at(uv: np.ndarray) -> np.ndarray:
    """The sphere's albedo (..., 3) at texture coordinates (..., 2): checks of two colours over slow waves."""
    u, v = uv[..., 0], uv[..., 1]
    check = (np.floor(24 * u) + np.floor(12 * v)) % 2
    colours = np.where(check[..., None] == 0, (0.55, 0.32, 0.20), (0.16, 0.28, 0.45))
    fine = 1.0 + 0.25 * np.sin(2 * np.pi * 60 * u) * np.sin(2 * np.pi * 40 * v)
    return colours * fine[..., None]


def light_at(normals: np.ndarray, photo: int) -> np.ndarray:
    """Irradiance (N, 3) on unit normals (N, 3) in a photo: one direction and tint each, and ambient light."""
    random = np.random.default_rng(photo)
    toward = random.normal(size=3)
    tint = random.uniform(0.8, 1.2, 3)
    facing = np.maximum(normals @ (toward / np.linalg.norm(toward)), 0.0)
    return tint * (AMBIENT + facing[:, None])


def sphere_points(uv: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) at texture coordinates (..., 2): u turns about z, v climbs from pole to pole."""
    longitude, latitude = 2 * np.pi * uv[..., 0], np.pi * (uv[..., 1] - 0.5)
    across = np.cos(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=-1)


def bumpy_sphere(rows: int) -> Mesh:
    """A mesh of 4 rows (rows - 1) triangles; 160 rows are 101,760. One chart, cut open along a meridian."""
    columns = 2 * rows
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(rows + 1) / rows, indexing="xy")
    grid_uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    unit = sphere_points(grid_uv)
    bumps = 1.0 + 0.05 * np.sin(6 * unit[:, 0]) * np.sin(6 * unit[:, 1]) * np.sin(6 * unit[:, 2])
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1]
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    lower, upper = np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)
    # at either pole one triangle of each quad has no area
    faces = np.concatenate([lower[1:].reshape(-1, 3), upper[:-1].reshape(-1, 3)]).astype(np.int32)
    return Mesh(unit * bumps[:, None], faces, grid_uv[faces])


class SphereSamples:
    """The light and albedo of the round sphere as samples, in place of a ray cache: `per_photo` random points of
    the whole sphere for each photo in turn; `ranges` (photos, 2) are their first sample and end.

    Texture coordinates and positions are float32 numbers and colours float16 ones, as in the ray cache, whatever
    `dtype` they are given in.
    """

    def __init__(self, photos: int, per_photo: int, dtype: torch.dtype) -> None:
        first = np.arange(photos) * per_photo
        self.ranges = np.stack([first, first + per_photo], axis=1)
        uv = np.random.default_rng(1).random((photos * per_photo, 2)).astype(np.float32).astype(np.float64)
        normals = sphere_points(uv)
        light = np.concatenate([light_at(normals[a:b], photo) for photo, (a, b) in enumerate(self.ranges)])
        colour = srgb_from_linear(albedo_at(uv) * light).astype(np.float16)
        columns = uv, (normals * 0.5 + 0.5).astype(np.float32), colour
        self._columns = [torch.from_numpy(column).to(dtype) for column in columns]
        self._photo = torch.from_numpy(np.repeat(np.arange(photos), per_photo))

    def samples(self, index: np.ndarray, device: torch.device) -> Samples:
        """The samples at `index` (N,), on `device`."""
        chosen = torch.from_numpy(index)
        columns = [column[chosen].to(device) for column in self._columns]
        return Samples(self._photo[chosen].to(device), *columns, prior=None)


def write_photos(folder: Path, mesh: Mesh, side: int, count: int, lights: int | None = None) -> list[Frame]:
    """Write `count` different JPEG photos of side x side pixels into `folder`; returns their frames. Each is under
    one of as many `lights`, drawn at random; by default under a light of its own."""
    camera = Camera("PINHOLE", side, side, (FOCAL * side, FOCAL * side, side / 2, side / 2))
    frame3d = Frame3D.bounding(mesh.vertices)
    caster = Raycaster(mesh, frame3d)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light_of = np.arange(count) if lights is None else np.random.default_rng(0).integers(lights, size=count)
    frames = []
    for index in range(count):
        frame = Frame(folder / "photos" / f"{side}_{index:03}.jpg", camera, pose(index, count))
        photo = np.full((side * side, 3), BACKGROUND, np.float32)
        origin = frame3d.normalise(frame.camera_to_world[:3, 3])
        for start in range(0, len(photo), PIXELS_AT_ONCE):
            pixel = np.arange(start, min(start + PIXELS_AT_ONCE, len(photo)))
            centres = np.column_stack([pixel % side, pixel // side]) + 0.5
            hits = caster.cast(origin, directions(camera, centres) @ frame.camera_to_world[:3, :3].T)
            weights = np.column_stack([1.0 - hits.bary.sum(axis=1), hits.bary])
            uv = np.einsum("nc,ncd->nd", weights, mesh.uvs[hits.face])  # type: ignore[index]
            linear = albedo_at(uv) * light_at(normals[hits.face], int(light_of[index]))
            photo[pixel[hits.ray]] = srgb_from_linear(linear).clip(0.0, 1.0)
        write(frame.image, photo.reshape(side, side, 3))
        frames.append(frame)
    return frames


def write_scene_folder(folder: Path, mesh: Mesh, frames: list[Frame], photos: int) -> None:
    """Write `mesh.obj` and a `transforms.json` of `photos` photos, which take turns among `frames`.

    A photo that comes again costs the reader, the rays and the cache as much as a new one, and no disk.
    """
    if not (folder / "mesh.obj").is_file():
        write_obj(folder / "mesh.obj", mesh)
    repeated = [frames[index % len(frames)] for index in range(photos)]
    write_scene(folder, Scene(folder / "transforms.json", folder / "mesh.obj", repeated))


def pose(index: int, count: int) -> np.ndarray:
    """Camera-to-world (4, 4) of one of `count` cameras that look at the centre from evenly around it."""
    height = 1.0 - 2.0 * (index + 0.5) / count  # a Fibonacci spiral over the sphere
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - height * height)
    backward = np.array([ring * np.cos(turn), ring * np.sin(turn), height])
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(backward, right), backward])
    matrix[:3, 3] = DISTANCE * backward
    return matrix
