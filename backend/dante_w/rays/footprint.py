"""How fine the photos' pixels are on the texture, estimated from a few rays before all are cast."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dante_w.contract.scene_folder import Frame
from dante_w.rays.cast_photos import CAST, footprints
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.cameras import directions


@dataclass(frozen=True)
class GlanceSettings:
    """How many rays are cast, and what is made of them."""

    #: Evenly spread photos that are looked at, at most.
    photos: int = 64
    #: Pixels along either side of each of these photos.
    pixels: int = 48
    #: Part of the samples that may be finer than the texture made for them: a few pixels from close by are not worth a
    #: texture four times as large.
    sharpest: float = 0.25
    #: Part of the texture that new charts fill, about, while the mesh has no UVs yet.
    filled: float = 0.6


GLANCE = GlanceSettings()


@dataclass(frozen=True)
class Glance:
    """What a few pixels show: the `footprint` (N,) of those that see the mesh, in parts of the texture's side, and their
    `share` of all pixels."""

    footprint: np.ndarray
    share: float


def glance(scene3d: Scene3D, frames: list[Frame], settings: GlanceSettings = GLANCE) -> Glance:
    """Cast a few pixels of some photos without reading the photos or their masks. A mesh without UVs is taken to get
    ones that spread it evenly."""
    if scene3d.mesh.uvs is None:
        corners = scene3d.corners()
        edges = corners[:, 1:] - corners[:, :1]
        area = 0.5 * float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())
        uv_scale = np.full(len(corners), math.sqrt(settings.filled / max(area, 1e-12)))
        scene3d = replace(scene3d, uv_scale=uv_scale)
    parts, cast = [np.zeros(0)], 0
    for number in np.unique(np.linspace(0, len(frames) - 1, settings.photos).round().astype(int)):
        frame = frames[number]
        middle = (np.arange(settings.pixels) + 0.5) / settings.pixels
        columns, rows = np.meshgrid(middle * frame.camera.width, middle * frame.camera.height)
        pixels = np.floor(np.column_stack([columns.ravel(), rows.ravel()])) + 0.5
        rays = directions(frame.camera, pixels) @ frame.camera_to_world[:3, :3].T
        hits = scene3d.caster.cast(scene3d.frame.normalise(frame.camera_to_world[:3, 3]), rays)
        cosine, footprint = footprints(frame, rays[hits.ray], hits, scene3d)
        parts.append(footprint[(cosine > CAST.grazing) & (scene3d.uv_scale[hits.face] > 0.0)])
        cast += len(rays)
    footprint = np.concatenate(parts)
    return Glance(footprint, len(footprint) / cast)


def sharp_footprint(footprint: np.ndarray, settings: GlanceSettings = GLANCE) -> float:
    """The footprint that all but the `sharpest` of some (N,) reach or exceed."""
    return float(np.quantile(footprint, settings.sharpest))
