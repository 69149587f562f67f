"""How fine the photos' pixels are on the texture, told by a few rays before all are cast."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dante_w.contract.scene_folder import Frame
from dante_w.rays.ray_cache import GRAZING, face_geometry, footprints
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.cameras import directions
from dante_w.scene.mesh import Mesh

#: Evenly spread photos that are looked at, at most, and pixels along either side of each.
PHOTOS, PIXELS = 64, 48
#: The part of the samples that may be finer than what is made for them.
SHARPEST = 0.25
#: The part of the texture that new charts fill, about.
FILLED = 0.6


@dataclass(frozen=True)
class Glance:
    """What a few pixels tell: the `footprint` (N,) of those that see the mesh, as parts of the texture's side, and their
    `share` of all pixels."""

    footprint: np.ndarray
    share: float


def glance(mesh: Mesh, frames: list[Frame]) -> Glance:
    """Cast a few pixels of some photos, without reading these: masks are not asked. A mesh without UVs is taken to get
    ones that spread it evenly."""
    frame3d = Frame3D.around(mesh)
    caster = Raycaster(mesh, frame3d)
    corners = frame3d.normalise(mesh.vertices)[mesh.faces]
    normals, length = face_geometry(
        corners, np.zeros((*corners.shape[:2], 2)) if mesh.uvs is None else mesh.uvs
    )
    if mesh.uvs is None:
        edges = corners[:, 1:] - corners[:, :1]
        area = 0.5 * float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())
        length = np.full(len(corners), math.sqrt(FILLED / max(area, 1e-12)))
    found, cast = [np.zeros(0)], 0
    for number in np.unique(np.linspace(0, len(frames) - 1, PHOTOS).round().astype(int)):
        frame = frames[number]
        middle = (np.arange(PIXELS) + 0.5) / PIXELS
        columns, rows = np.meshgrid(middle * frame.camera.width, middle * frame.camera.height)
        pixels = np.floor(np.column_stack([columns.ravel(), rows.ravel()])) + 0.5
        rays = directions(frame.camera, pixels) @ frame.camera_to_world[:3, :3].T
        hits = caster.cast(frame3d.normalise(frame.camera_to_world[:3, 3]), rays)
        cosine, footprint = footprints(frame, rays[hits.ray], hits, normals, length)
        found.append(footprint[(cosine > GRAZING) & (length[hits.face] > 0.0)])
        cast += len(rays)
    footprint = np.concatenate(found)
    return Glance(footprint, len(footprint) / cast)


def sharp(footprint: np.ndarray) -> float:
    """The footprint that all but `SHARPEST` of some (N,) reach or exceed."""
    return float(np.quantile(footprint, SHARPEST))
