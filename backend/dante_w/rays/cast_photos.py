"""Fill the ray cache: one ray through each foreground pixel centre of each photo, to the surface point it sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import torch

from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Frame
from dante_w.core.jit import njit_fast
from dante_w.rays.depth_edges import EDGES, EdgeSettings, edge_distances
from dante_w.rays.finest_footprint import no_footprints, note_finest
from dante_w.rays.normals import NORMALS, NormalSettings, corner_normals
from dante_w.rays.radiance_levels import RADIANCE, RadianceSettings, into_range
from dante_w.rays.ray_cache import PhotoSamples, RayCache, RayCacheBuilder, Surface, sample_bytes
from dante_w.rays.raycast import Hits
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.cameras import directions
from dante_w.scene.images import Photo, read_photo, read_prior


@dataclass(frozen=True)
class CastSettings:
    """Which pixels become samples, and where samples are kept."""

    #: Cosine between ray and normal: surfaces seen at a flatter angle are left out, as their pixels smear over many texels.
    grazing: float = 0.1
    #: Parts of the texture's side: footprints are at least this, a quarter of the finest texel. A camera may touch the
    #: surface.
    least_footprint: float = 2.0**-16
    #: Part of the free memory that the cache may fill; a larger one lies in files.
    share_of_memory: float = 1.0 / 3.0
    #: Pixels made into rays at once, which bounds the memory of rays and hits.
    pixels_at_once: int = 1 << 20
    edges: EdgeSettings = EDGES
    normals: NormalSettings = NORMALS
    radiance: RadianceSettings = RADIANCE


CAST = CastSettings()

#: Called for each photo with texture coordinates (N, 2) float64, the pixels' footprints on the texture as
#: fractions of its side (N,), and sRGB-encoded colours (N, 3).
Visitor = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


def cast_photos(
    scene3d: Scene3D,
    frames: Sequence[Frame],
    visit: Visitor,
    progress: Callable[[float], None],
    spill: Path,
    settings: CastSettings = CAST,
) -> RayCache:
    """Cast one ray through each foreground pixel centre of each photo.

    Args:
        scene3d: of a mesh with UVs.
        frames: the photos; a frame's prior is used when it has one.
        visit: sees each photo's hits while they are at hand.
        progress: called with the fraction done.
        spill: folder for the cache where it does not fit into its share of the memory.

    Raises:
        BadInput: a photo cannot be read, or no pixel sees the mesh.
    """
    uvs = scene3d.mesh.uvs
    assert uvs is not None
    prior = any(frame.albedo for frame in frames)
    size = sample_bytes(prior) * sum(frame.camera.width * frame.camera.height for frame in frames)
    to_disk = size > settings.share_of_memory * psutil.virtual_memory().available
    builder = RayCacheBuilder(prior, spill if to_disk else None)
    finest = no_footprints()
    any_foreground = False
    with ThreadPoolExecutor(2) as readers:  # a photo or two ahead of the rays, no more in memory
        loading = [readers.submit(_read, frame) for frame in frames[:2]]
        for index, frame in enumerate(frames):
            photo, albedo = loading.pop(0).result()
            if index + 2 < len(frames):
                loading.append(readers.submit(_read, frames[index + 2]))
            pixel, face, bary, footprint, edge = _cast_photo(frame, photo, scene3d, settings)
            colour = photo.srgb.reshape(-1, 3)[pixel]
            stored, log_gain = into_range(colour, settings.radiance) if photo.linear else (colour, 0.0)
            albedo = None if albedo is None else albedo.reshape(-1, 4)[pixel]
            builder.add(PhotoSamples(face, bary, stored, footprint, edge, albedo, log_gain))
            any_foreground = any_foreground or bool(photo.foreground.any())
            uv = _interpolate(uvs, face, bary)
            note_finest(uv, footprint.astype(np.float16).astype(np.float32), finest)
            visit(uv, footprint, colour)
            progress((index + 1) / len(frames))
    if not any_foreground:
        raise BadInput(
            f"{frames[0].image.parent}: all pixels of all photos are masked out or not finite numbers; check the photos "
            "and their masks."
        )
    if len(builder) == 0:
        raise BadInput(
            f"{frames[0].image.parent}: no pixel sees the mesh; check that cameras and mesh share one "
            "coordinate system."
        )
    return builder.finish(surface(scene3d, settings.normals), finest)


def surface(scene3d: Scene3D, settings: NormalSettings = NORMALS) -> Surface:
    """The corners' UVs, positions and shading normals, as samples need them; the mesh has UVs."""
    corners = scene3d.corners()
    normals = corner_normals(scene3d.mesh, corners, scene3d.face_normals, settings)
    arrays = scene3d.mesh.uvs, corners, normals
    return Surface(*(torch.from_numpy(np.asarray(array, np.float32)) for array in arrays))


def _read(frame: Frame) -> tuple[Photo, np.ndarray | None]:
    photo = read_photo(frame.image, frame.mask)
    if frame.albedo is None:
        return photo, None
    return photo, _resize(read_prior(frame.albedo), (frame.camera.width, frame.camera.height))


def _resize(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Bilinear, pixel centres aligned; priors often come smaller than their photo."""
    if image.shape[1::-1] == size:
        return image
    planes = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None]
    resized = torch.nn.functional.interpolate(planes, size[::-1], mode="bilinear", antialias=True)
    return resized[0].permute(1, 2, 0).contiguous().numpy()


def _cast_photo(
    frame: Frame, photo: Photo, scene3d: Scene3D, settings: CastSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixel index, face, barycentric weights, footprint and distance to an edge of each pixel that sees the mesh."""
    foreground = np.flatnonzero(photo.foreground.reshape(-1))
    rotation = frame.camera_to_world[:3, :3]
    origin = scene3d.frame.normalise(frame.camera_to_world[:3, 3])
    depth = np.zeros(frame.camera.height * frame.camera.width, np.float32)
    parts = []
    for start in range(0, len(foreground), settings.pixels_at_once):
        pixel = foreground[start : start + settings.pixels_at_once]
        centres = np.column_stack([pixel % frame.camera.width, pixel // frame.camera.width]) + 0.5
        rays = directions(frame.camera, centres) @ rotation.T
        hits = scene3d.caster.cast(origin, rays)
        cosine, footprint = footprints(frame, rays[hits.ray], hits, scene3d, settings)
        depth[pixel[hits.ray]] = hits.distance
        # a face without area on the texture has no place there
        keep = (cosine > settings.grazing) & (scene3d.uv_scale[hits.face] > 0.0)
        parts.append((pixel[hits.ray[keep]], hits.face[keep], hits.bary[keep], footprint[keep]))
    if not parts:
        return (
            np.zeros(0, np.int64),
            np.zeros(0, np.int32),
            np.zeros((0, 2)),
            np.zeros(0),
            np.zeros(0, np.uint8),
        )
    pixel, face, bary, footprint = (np.concatenate(column) for column in zip(*parts, strict=True))
    image = depth.reshape(frame.camera.height, frame.camera.width)
    edge = edge_distances(image, frame.camera.params[0], settings.edges).reshape(-1)
    return pixel, face, bary, footprint, edge[pixel]


def footprints(
    frame: Frame, rays: np.ndarray, hits: Hits, scene3d: Scene3D, settings: CastSettings = CAST
) -> tuple[np.ndarray, np.ndarray]:
    """How pixels meet the surface.

    Args:
        rays: (N, 3) directions of the rays that hit, any length.
        hits: (N,) what they hit.

    Returns:
        (N,) cosine between ray and surface normal, and (N,) footprint of the pixel in parts of the texture's side.
    """
    length = np.linalg.norm(rays, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", rays, scene3d.face_normals[hits.face])) / length
    # one pixel spans depth / focal length across the ray, and 1 / cosine more along the surface
    span = hits.distance * length / frame.camera.params[0] / np.maximum(cosine, settings.grazing)
    return cosine, np.maximum(span * scene3d.uv_scale[hits.face], settings.least_footprint)


@njit_fast
def _interpolate(corners, face, bary):  # type: ignore[no-untyped-def]
    """(N, 2) float64 from what corners have, (F, 3, 2), at faces (N,) and weights (N, 2)."""
    out = np.empty((len(face), 2))
    for i in range(len(face)):
        f, second, third = face[i], float(bary[i, 0]), float(bary[i, 1])
        for d in range(2):
            out[i, d] = (
                (1.0 - second - third) * corners[f, 0, d]
                + second * corners[f, 1, d]
                + third * corners[f, 2, d]
            )
    return out
