"""The ray cache: every foreground pixel of every photo and the surface point it sees, traced once.

A sample takes 17 bytes, or 25 with a prior: the face (int32) and two barycentric weights (uint16) give texture
coordinate, position and normal; the photo's colour and the prior's albedo are three halves each, sRGB-encoded, and
how far the prior is to be trusted there is one; the pixel's footprint on the texture is a half; its distance in the
photo to the next edge in depth is a byte.
Samples lie photo after photo in raster order, so the photo needs no storage either, and neighbours on the
surface are neighbours in memory.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch

from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Frame
from dante_w.core.jit import njit_fast
from dante_w.rays.depth_edges import edge_distances
from dante_w.rays.normals import corner_normals
from dante_w.rays.radiance_levels import levelled
from dante_w.rays.raycast import Frame3D, Hits, Raycaster
from dante_w.scene.cameras import directions
from dante_w.scene.images import Photo, read_photo, read_prior
from dante_w.scene.mesh import Mesh

#: Surfaces seen at a flatter angle than this cosine are left out: their pixels smear over many texels.
GRAZING = 0.1
#: Footprints are at least this, a quarter of the finest texel: a camera may touch the surface.
LEAST_FOOTPRINT = 2.0**-16
#: The largest finite half; brighter encoded values are stored as this.
HALF_MAX = 65504.0
#: Part of the free memory that the cache may fill; a larger one lies in files.
SHARE_OF_MEMORY = 1.0 / 3.0
#: Pixels made into rays at once.
PIXELS_AT_ONCE = 1 << 20
#: Cells a side in which the finest footprint is noted.
CELLS = 256
#: Power of the footprints' ratio by which pixels from afar weigh less.
SHARPNESS = 2
_FIELDS = {
    "face": (np.int32, ()),
    "bary": (np.uint16, (2,)),
    "colour": (np.float16, (3,)),
    "footprint": (np.float16, ()),
    "edge": (np.uint8, ()),
}
_PRIOR = {"prior": (np.float16, (4,))}


@dataclass(frozen=True)
class Surface:
    """The mesh as the samples need it, per face corner: texture coordinates (F, 3, 2), positions (F, 3, 3)
    in the unit cube, and shading normals (F, 3, 3), without which the faces' own are taken; float32."""

    uvs: torch.Tensor
    positions: torch.Tensor
    normals: torch.Tensor | None = None


@dataclass(frozen=True)
class Samples:
    """A batch: photo index (N,), texture coordinate (N, 2), position in the unit cube (N, 3), photo colour (N, 3) and prior
    albedo with its trust in [0, 1] (N, 4), colours sRGB-encoded; `prior` is None without priors, NaN where a photo has none.
    `weight` (N,) is how much a sample counts, see `RayCache.finest`; None: all alike."""

    photo: torch.Tensor
    uv: torch.Tensor
    position: torch.Tensor
    colour: torch.Tensor
    prior: torch.Tensor | None
    weight: torch.Tensor | None = None


@dataclass(frozen=True)
class RayCache:
    """All samples of all photos. `starts` (K + 1,) bounds each photo's run of samples; `footprint` (N,) is the part of
    the texture's side that a pixel covers, None if unknown; `edge` (N,) how many pixels it is from the next edge in the
    photo's depth, see `edges`, None if unknown.

    finest: (`CELLS`, `CELLS`) float32, the smallest footprint in each cell of the texture, infinite where no photo looks.
    A sample weighs (finest / footprint)^`SHARPNESS` there, so pixels from afar do not blur what closer ones tell.

    level: (K,) log of what the linear colours of each photo were multiplied with; None: with nothing. It is not 0 for float
    photos alone.
    """

    surface: Surface
    starts: np.ndarray
    face: np.ndarray
    bary: np.ndarray
    colour: np.ndarray
    prior: np.ndarray | None
    footprint: np.ndarray | None = None
    finest: np.ndarray | None = None
    edge: np.ndarray | None = None
    level: np.ndarray | None = None

    def __len__(self) -> int:
        return int(self.starts[-1])

    def of(self, keep: np.ndarray) -> RayCache:
        """The samples (M,) with these numbers, in ascending order; a photo may be left with none."""
        columns = {name: getattr(self, name) for name in (*_FIELDS, *_PRIOR)}
        kept: dict[str, Any] = {
            name: None if column is None else column[keep] for name, column in columns.items()
        }
        return replace(self, starts=np.searchsorted(keep, self.starts), **kept)

    def forget(self) -> None:
        """Give back the memory of what was read from files; it is read again when it is asked for."""
        for column in (self.face, self.bary, self.colour, self.prior, self.footprint, self.edge):
            if isinstance(column, np.memmap) and hasattr(mmap, "MADV_DONTNEED"):
                column._mmap.madvise(mmap.MADV_DONTNEED)  # type: ignore[attr-defined]

    def samples(self, index: np.ndarray, device: torch.device) -> Samples:
        """The samples at `index` (N,), on `device`."""
        photo = np.searchsorted(self.starts, index, side="right") - 1
        uv, position = torch.empty(len(index), 2), torch.empty(len(index), 3)
        corners = self.surface.uvs.numpy(), self.surface.positions.numpy()
        on_surface(self.face[index], self.bary[index], *corners, uv.numpy(), position.numpy())

        def fetch(array: np.ndarray | None) -> torch.Tensor | None:
            return None if array is None else torch.from_numpy(array[index].astype(np.float32)).to(device)

        weight = None
        if self.footprint is not None and self.finest is not None:
            weight = np.empty(len(index), np.float32)
            _weigh(uv.numpy(), self.footprint[index].astype(np.float32), self.finest, weight)
        return Samples(
            torch.from_numpy(photo).to(device),
            uv.to(device),
            position.to(device),
            torch.from_numpy(self.colour[index].astype(np.float32)).to(device),
            fetch(self.prior),
            None if weight is None else torch.from_numpy(weight).to(device),
        )


@njit_fast
def on_surface(face, bary, uvs, positions, uv, position):  # type: ignore[no-untyped-def]
    """Texture coordinates (N, 2) and positions (N, 3) from faces (N,), their stored weights (N, 2), and what the corners
    have, (F, 3, 2) and (F, 3, 3)."""
    unit = np.float32(1.0 / 65535.0)
    for i in range(len(face)):
        f, second, third = face[i], bary[i, 0] * unit, bary[i, 1] * unit
        first = np.float32(1.0) - second - third
        for d in range(2):
            uv[i, d] = first * uvs[f, 0, d] + second * uvs[f, 1, d] + third * uvs[f, 2, d]
        for d in range(3):
            corner = positions[f, :, d]
            position[i, d] = first * corner[0] + second * corner[1] + third * corner[2]


@njit_fast
def note_finest(uv, footprint, finest):  # type: ignore[no-untyped-def]
    """Lower `finest` (CELLS, CELLS) to the footprints (N,) of pixels around texture coordinates (N, 2)."""
    for i in range(len(uv)):
        own = footprint[i]
        for y in range(_cell(uv[i, 1] - own / 2), _cell(uv[i, 1] + own / 2) + 1):
            for x in range(_cell(uv[i, 0] - own / 2), _cell(uv[i, 0] + own / 2) + 1):
                finest[y, x] = min(finest[y, x], own)


@njit_fast
def _weigh(uv, footprint, finest, weight):  # type: ignore[no-untyped-def]
    """Weights (N,) in [0, 1] of samples; see `RayCache`."""
    for i in range(len(uv)):
        least, own = finest[_cell(uv[i, 1]), _cell(uv[i, 0])], footprint[i]
        weight[i] = (least / own) ** SHARPNESS if least < own else 1.0


@njit_fast
def _cell(coordinate):  # type: ignore[no-untyped-def]
    return min(max(int(coordinate * CELLS), 0), CELLS - 1)


#: Called for each photo with texture coordinates (N, 2) float64, the pixels' footprints on the texture as
#: fractions of its side (N,), and sRGB-encoded colours (N, 3).
Visitor = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


def trace(
    mesh: Mesh,
    frames: Sequence[Frame],
    visit: Visitor,
    progress: Callable[[float], None],
    spill: Path,
) -> RayCache:
    """Cast one ray through each foreground pixel centre of each photo.

    Args:
        mesh: with UVs.
        frames: the photos; a frame's prior is used when it has one.
        visit: sees each photo's hits while they are at hand.
        progress: called with the fraction done.
        spill: folder for the cache when it would fill more than `SHARE_OF_MEMORY`.

    Raises:
        BadInput: a photo cannot be read, or no pixel sees the mesh.
    """
    assert mesh.uvs is not None
    frame3d = Frame3D.around(mesh)
    caster = Raycaster(mesh, frame3d)
    corners = frame3d.normalise(mesh.vertices)[mesh.faces]
    fields = dict(_FIELDS)
    if any(frame.albedo for frame in frames):
        fields |= _PRIOR
    pixels = sum(frame.camera.width * frame.camera.height for frame in frames)
    to_disk = pixels * sample_bytes("prior" in fields) > SHARE_OF_MEMORY * psutil.virtual_memory().available
    columns = {name: _Column(spill / name if to_disk else None, *fields[name]) for name in fields}

    face_normals, texels_per_length = face_geometry(corners, mesh.uvs)
    finest = np.full((CELLS, CELLS), np.inf, np.float32)
    counts, levels, looked = [], [], False
    with ThreadPoolExecutor(2) as readers:  # a photo or two ahead of the rays, no more in memory
        loading = [readers.submit(_read, frame) for frame in frames[:2]]
        for index, frame in enumerate(frames):
            photo, prior = loading.pop(0).result()
            if index + 2 < len(frames):
                loading.append(readers.submit(_read, frames[index + 2]))
            found = _trace_photo(frame, photo, caster, frame3d, face_normals, texels_per_length)
            pixel, face, bary, footprint, edge = found
            colour = photo.srgb.reshape(-1, 3)[pixel]
            columns["face"].append(face)
            columns["bary"].append(np.rint(bary * 65535.0))
            kept, level = levelled(colour) if photo.linear else (colour, 0.0)
            columns["colour"].append(kept.clip(-HALF_MAX, HALF_MAX))
            levels.append(level)
            columns["footprint"].append(footprint.clip(0.0, HALF_MAX))
            columns["edge"].append(edge)
            if "prior" in columns:
                empty = np.full((len(pixel), 4), np.nan, np.float16)
                columns["prior"].append(
                    empty if prior is None else prior.reshape(-1, 4)[pixel].clip(0.0, 1.0)
                )
            counts.append(len(pixel))
            looked = looked or bool(photo.foreground.any())
            uv = _interpolate(mesh.uvs, face, bary)
            note_finest(uv, footprint.astype(np.float16).astype(np.float32), finest)
            visit(uv, footprint, colour)
            progress((index + 1) / len(frames))
    if not looked:
        raise BadInput(
            f"{frames[0].image.parent}: all pixels of all photos are masked out or not finite numbers; check the photos "
            "and their masks."
        )
    if sum(counts) == 0:
        raise BadInput(
            f"{frames[0].image.parent}: no pixel sees the mesh; check that cameras and mesh share one "
            "coordinate system."
        )
    arrays = {name: column.finish() for name, column in columns.items()}
    surface = surface_of(mesh, corners, face_normals)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return RayCache(
        surface,
        starts,
        arrays["face"],
        arrays["bary"],
        arrays["colour"],
        arrays.get("prior"),
        arrays["footprint"],
        finest,
        arrays["edge"],
        np.array(levels),
    )


def surface_of(mesh: Mesh, corners: np.ndarray, face_normals: np.ndarray) -> Surface:
    """What samples of `mesh`, which has UVs, need of it; arguments as of `corner_normals`, in the unit cube."""
    arrays = mesh.uvs, corners, corner_normals(mesh, corners, face_normals)
    return Surface(*(torch.from_numpy(np.asarray(array, np.float32)) for array in arrays))


def sample_bytes(prior: bool) -> int:
    """What a sample takes, with or without a prior."""
    fields = _FIELDS | (_PRIOR if prior else {})
    return sum(np.dtype(kind).itemsize * int(np.prod(shape)) for kind, shape in fields.values())


class _Column:
    """One field of the cache while it grows, in memory or in a file."""

    def __init__(self, file: Path | None, kind: type, shape: tuple[int, ...]) -> None:
        self._kind, self._shape = np.dtype(kind), shape
        self._file, self._rows = file, 0
        self._parts: list[np.ndarray] = []

    def append(self, rows: np.ndarray) -> None:
        rows = np.ascontiguousarray(rows, self._kind)
        self._rows += len(rows)
        if self._file is None:
            self._parts.append(rows)
        else:
            with open(self._file, "ab") as out:
                out.write(rows.data)

    def finish(self) -> np.ndarray:
        if self._file is None:
            parts, self._parts = self._parts, []
            return np.concatenate(parts)
        return np.memmap(self._file, self._kind, "r", shape=(self._rows, *self._shape))


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


def _trace_photo(
    frame: Frame,
    photo: Photo,
    caster: Raycaster,
    frame3d: Frame3D,
    face_normals: np.ndarray,
    texels_per_length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixel index, face, barycentric weights, footprint and distance to an edge of each pixel that sees the mesh."""
    foreground = np.flatnonzero(photo.foreground.reshape(-1))
    rotation = frame.camera_to_world[:3, :3]
    origin = frame3d.normalise(frame.camera_to_world[:3, 3])
    depth = np.zeros(frame.camera.height * frame.camera.width, np.float32)
    parts = []
    for start in range(0, len(foreground), PIXELS_AT_ONCE):
        pixel = foreground[start : start + PIXELS_AT_ONCE]
        centres = np.column_stack([pixel % frame.camera.width, pixel // frame.camera.width]) + 0.5
        rays = directions(frame.camera, centres) @ rotation.T
        hits = caster.cast(origin, rays)
        cosine, footprint = footprints(frame, rays[hits.ray], hits, face_normals, texels_per_length)
        depth[pixel[hits.ray]] = hits.distance
        keep = (cosine > GRAZING) & (texels_per_length[hits.face] > 0.0)  # what has no place on the texture
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
    edge = edge_distances(image, frame.camera.params[0]).reshape(-1)
    return pixel, face, bary, footprint, edge[pixel]


def footprints(
    frame: Frame, rays: np.ndarray, hits: Hits, face_normals: np.ndarray, texels_per_length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cosine between ray and surface, and the pixel's footprint, both (N,); `rays` (N, 3) are those that hit."""
    length = np.linalg.norm(rays, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", rays, face_normals[hits.face])) / length
    # one pixel spans depth / focal length across the ray, and 1 / cosine more along the surface
    span = hits.distance * length / frame.camera.params[0] / np.maximum(cosine, GRAZING)
    return cosine, np.maximum(span * texels_per_length[hits.face], LEAST_FOOTPRINT)


def face_geometry(corners: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (F, 3), zero for degenerate faces, and texture lengths per unit-cube length (F,)."""
    edges = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(cross, axis=1)
    sides = uvs[:, 1:] - uvs[:, :1]
    uv_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    solid = area > 0.0
    safe = np.where(solid, area, 1.0)
    return cross / safe[:, None], np.sqrt(np.where(solid, uv_area / safe, 0.0))


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
