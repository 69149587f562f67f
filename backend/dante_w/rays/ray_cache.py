"""The ray cache: every foreground pixel of every photo and the surface point it sees, in a compact form.

A sample takes 17 bytes, or 25 with a prior: the face (int32) and two barycentric weights (uint16) give texture
coordinate, position and normal; the photo's colour and the prior's albedo are three halves each, sRGB-encoded, and
the prior's weight is one more; the pixel's footprint on the texture is a half; its distance in the photo to the next
edge in depth is a byte.
Samples lie photo after photo in raster order, so the photo needs no storage either, and neighbours on the
surface are neighbours in memory. `cast_photos` fills it.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dante_w.core.jit import njit_fast
from dante_w.rays.finest_footprint import sharpness_weights

#: The largest finite half; brighter encoded values are stored as this.
HALF_MAX = 65504.0
#: Barycentric weights are whole multiples of one over this.
BARY_STEPS = 65535.0
_FIELDS = {
    "face": (np.int32, ()),
    "bary": (np.uint16, (2,)),
    "colour": (np.float16, (3,)),
    "footprint": (np.float16, ()),
    "edge": (np.uint8, ()),
}
_PRIOR = {"prior": (np.float16, (4,))}


def sample_bytes(prior: bool) -> int:
    """What a sample takes, with or without a prior."""
    return sum(np.dtype(kind).itemsize * int(np.prod(shape)) for kind, shape in _fields(prior).values())


def _fields(prior: bool) -> dict[str, tuple[Any, tuple[int, ...]]]:
    return {**_FIELDS, **_PRIOR} if prior else dict(_FIELDS)


@dataclass(frozen=True)
class Surface:
    """The mesh as the samples need it, per face corner: texture coordinates (F, 3, 2), positions (F, 3, 3)
    in the unit cube, and shading normals (F, 3, 3), without which the faces' own are taken; float32."""

    uvs: torch.Tensor
    positions: torch.Tensor
    normals: torch.Tensor | None = None


@dataclass(frozen=True)
class Samples:
    """A batch of N samples on one device, float32.

    Attributes:
        photo: (N,) int64 index of the photo.
        uv: (N, 2) texture coordinates.
        position: (N, 3) in the unit cube.
        colour: (N, 3) of the photo, sRGB-encoded.
        prior: (N, 4) albedo, sRGB-encoded, and its weight in [0, 1]; NaN where a photo has none. None without priors.
        weight: (N,) how much a sample counts, see `RayCache.finest`; None: all alike.
    """

    photo: torch.Tensor
    uv: torch.Tensor
    position: torch.Tensor
    colour: torch.Tensor
    prior: torch.Tensor | None
    weight: torch.Tensor | None = None


@dataclass(frozen=True)
class RayCache:
    """All N samples of all K photos.

    Attributes:
        surface: of the mesh.
        starts: (K + 1,) int64, bounds of each photo's run of samples.
        face: (N,) int32. bary: (N, 2) uint16, weights of the face's second and third corner in 1/65535.
        colour: (N, 3) float16, sRGB-encoded.
        prior: (N, 4) float16, see `Samples`, or None.
        footprint: (N,) float16, the part of the texture's side that a pixel covers; None if unknown.
        finest: (cells, cells) float32, the smallest footprint in each cell of the texture, infinite where no photo
            looks; None if unknown. A sample weighs (finest / footprint)^2 there, see `finest_footprint`.
        edge: (N,) uint8, pixels from the next edge in the photo's depth, see `depth_edges`; None if unknown.
        log_gain: (K,) log of what the linear colours of each photo were multiplied with; None: with nothing. It is not
            0 for float photos alone.
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
    log_gain: np.ndarray | None = None

    def __len__(self) -> int:
        return int(self.starts[-1])

    def subset(self, index: np.ndarray) -> RayCache:
        """The samples (M,) with these numbers, in ascending order; a photo may be left with none."""
        columns: dict[str, Any] = {
            name: None if column is None else column[index] for name, column in self._columns().items()
        }
        return replace(self, starts=np.searchsorted(index, self.starts), **columns)

    def forget(self) -> None:
        """Give back the memory of what was read from files; it is read again when it is used."""
        for column in self._columns().values():
            file = None if column is None else column.base
            if isinstance(file, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
                file.madvise(mmap.MADV_DONTNEED)

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
            sharpness_weights(uv.numpy(), self.footprint[index].astype(np.float32), self.finest, weight)
        return Samples(
            torch.from_numpy(photo).to(device),
            uv.to(device),
            position.to(device),
            torch.from_numpy(self.colour[index].astype(np.float32)).to(device),
            fetch(self.prior),
            None if weight is None else torch.from_numpy(weight).to(device),
        )

    def _columns(self) -> dict[str, np.ndarray | None]:
        return {name: getattr(self, name) for name in _fields(prior=True)}


@njit_fast
def on_surface(face, bary, uvs, positions, uv, position):  # type: ignore[no-untyped-def]
    """Texture coordinates (N, 2) and positions (N, 3) from faces (N,), their stored weights (N, 2), and what the corners
    have, (F, 3, 2) and (F, 3, 3)."""
    unit = np.float32(1.0 / BARY_STEPS)
    for i in range(len(face)):
        f, second, third = face[i], bary[i, 0] * unit, bary[i, 1] * unit
        first = np.float32(1.0) - second - third
        for d in range(2):
            uv[i, d] = first * uvs[f, 0, d] + second * uvs[f, 1, d] + third * uvs[f, 2, d]
        for d in range(3):
            corner = positions[f, :, d]
            position[i, d] = first * corner[0] + second * corner[1] + third * corner[2]


@dataclass(frozen=True)
class PhotoSamples:
    """The N samples of one photo before they are quantised.

    Attributes:
        face: (N,) integers. bary: (N, 2) floats in [0, 1], weights of the face's second and third corner.
        colour: (N, 3) float32, sRGB-encoded. log_gain: log of what its linear colours were multiplied with.
        footprint: (N,) parts of the texture's side. edge: (N,) uint8, see `RayCache`.
        prior: (N, 4) float32, see `Samples`; None if this photo has none.
    """

    face: np.ndarray
    bary: np.ndarray
    colour: np.ndarray
    footprint: np.ndarray
    edge: np.ndarray
    prior: np.ndarray | None = None
    log_gain: float = 0.0

    def __len__(self) -> int:
        return len(self.face)


class RayCacheBuilder:
    """A ray cache that grows photo by photo, in memory or in files.

    Args:
        prior: whether samples have a prior.
        folder: for a file of each field; None: in memory.
    """

    def __init__(self, prior: bool, folder: Path | None) -> None:
        self._columns = {
            name: _Column(folder / name if folder else None, *field) for name, field in _fields(prior).items()
        }
        self._counts: list[int] = []
        self._log_gains: list[float] = []

    def __len__(self) -> int:
        return sum(self._counts)

    def add(self, photo: PhotoSamples) -> None:
        """Quantise the samples of the next photo and append them."""
        self._columns["face"].append(photo.face)
        self._columns["bary"].append(np.rint(photo.bary * BARY_STEPS))
        self._columns["colour"].append(photo.colour.clip(-HALF_MAX, HALF_MAX))
        self._columns["footprint"].append(photo.footprint.clip(0.0, HALF_MAX))
        self._columns["edge"].append(photo.edge)
        if "prior" in self._columns:
            missing = np.full((len(photo), 4), np.nan, np.float16)
            self._columns["prior"].append(missing if photo.prior is None else photo.prior.clip(0.0, 1.0))
        self._counts.append(len(photo))
        self._log_gains.append(photo.log_gain)

    def finish(self, surface: Surface, finest: np.ndarray | None = None) -> RayCache:
        """The cache of all photos, on this surface; no `add` after this."""
        arrays: dict[str, Any] = {name: column.finish() for name, column in self._columns.items()}
        starts = np.concatenate([[0], np.cumsum(self._counts)]).astype(np.int64)
        prior = arrays.pop("prior", None)
        return RayCache(
            surface, starts, prior=prior, finest=finest, log_gain=np.array(self._log_gains), **arrays
        )


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
