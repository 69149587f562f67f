"""Where rays first meet the mesh, by Embree, on all cores."""

from __future__ import annotations

import mmap
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from dante_w.scene.mesh import Mesh


@dataclass(frozen=True)
class RaycastSettings:
    """Limits of Embree."""

    #: Rays in one call: enough to amortise it, few enough to spread over threads.
    chunk: int = 1 << 17
    #: Bytes of address space that a scene takes at least ...
    scene_bytes: int = 192 << 20
    #: ... and about so many more for each triangle while the BVH is built.
    triangle_bytes: int = 400
    #: Sides of the unit cube: rays from further off begin nearer. Embree's float32 would miss their pixels.
    farthest: float = 4.0


RAYCAST = RaycastSettings()


@dataclass(frozen=True)
class Frame3D:
    """The similarity that takes the mesh's bounding cube to [0, 1]^3: x01 = (x - origin) / extent.

    Everything downstream is float32 or less, so geometry is recentred here, in float64, once.
    """

    origin: np.ndarray
    extent: float

    @classmethod
    def bounding(cls, vertices: np.ndarray) -> Frame3D:
        """The frame of the bounding cube of world points (N, 3)."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        extent = float((high - low).max()) or 1.0
        return cls((low + high) / 2.0 - extent / 2.0, extent)

    @classmethod
    def around(cls, mesh: Mesh) -> Frame3D:
        """The frame of a mesh's triangles, whatever vertices it has beside."""
        used = np.zeros(len(mesh.vertices), bool)
        used[mesh.faces] = True
        return cls.bounding(mesh.vertices[used])

    def normalise(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) to the unit cube, float64."""
        return (np.asarray(points, np.float64) - self.origin) / self.extent


def _check_memory(triangles: int, settings: RaycastSettings) -> None:
    """Embree crashes where it finds no memory.

    Raises:
        MemoryError: it would.
    """
    try:
        mmap.mmap(-1, settings.scene_bytes + triangles * settings.triangle_bytes).close()
    except (OSError, OverflowError) as error:
        raise MemoryError("out of memory for the mesh") from error


@dataclass(frozen=True)
class Hits:
    """First hits of a bundle of rays. `ray` are the indices (M,) of the rays that met the mesh; for those,
    `face` (M,), barycentric weights `bary` (M, 2) of the face's second and third corner, and `distance`
    (M,) in units of the ray direction's length."""

    ray: np.ndarray
    face: np.ndarray
    bary: np.ndarray
    distance: np.ndarray


class Raycaster:
    """An Embree scene over a mesh in its unit cube (`Frame3D`).

    Raises:
        MemoryError: there is none for it.
    """

    def __init__(self, mesh: Mesh, frame: Frame3D, settings: RaycastSettings = RAYCAST) -> None:
        _check_memory(len(mesh.faces), settings)
        self._settings = settings
        self._scene = EmbreeScene()
        vertices = frame.normalise(mesh.vertices).astype(np.float32)
        self._mesh = TriangleMesh(self._scene, vertices, mesh.faces.astype(np.int32))
        self._threads = ThreadPoolExecutor(os.cpu_count())
        self._cast(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # builds the BVH at once

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> Hits:
        """First hits of rays from one point.

        Args:
            origin: (3,) in the unit cube's frame; may lie outside of it.
            directions: (N, 3), any length; rays with a direction that is not finite hit nothing.
        """
        distance = float(np.linalg.norm(np.asarray(origin) - 0.5))
        if distance <= self._settings.farthest:
            return self.cast_from(np.broadcast_to(origin, directions.shape), directions)
        # the cube lies within 0.9 of its centre, so nothing is met before
        ahead = (distance - 0.5 * self._settings.farthest) / np.linalg.norm(directions, axis=1)
        hits = self.cast_from(origin + ahead[:, None] * directions, directions)
        return replace(hits, distance=hits.distance + ahead[hits.ray])

    def cast_from(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """First hits of rays that each have an origin (N, 3) of their own; see `cast`."""
        usable = np.flatnonzero(np.isfinite(directions).all(axis=1))
        size = self._settings.chunk

        def chunk(start: int) -> Hits:
            rays = usable[start : start + size]
            result = self._cast(origins[rays].astype(np.float32), directions[rays].astype(np.float32))
            hit = np.flatnonzero(result["primID"] >= 0)
            return Hits(
                rays[hit],
                result["primID"][hit],
                np.column_stack([result["u"][hit], result["v"][hit]]),
                result["tfar"][hit],
            )

        parts = list(self._threads.map(chunk, range(0, len(usable), size)))
        if not parts:
            empty = np.zeros(0, np.int64)
            return Hits(empty, empty, np.zeros((0, 2), np.float32), np.zeros(0, np.float32))
        fields = ("ray", "face", "bary", "distance")
        return Hits(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))

    def first(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Face (N,), -1 for none, and barycentric weights (N,) of its second and third corner, where rays, float32 (N, 3),
        first hit. Runs in the caller's thread, without the GIL: for callers who have threads of their own."""
        result = self._cast(origins, directions)
        return result["primID"], result["u"], result["v"]

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(N,) bool: whether rays, float32 (N, 3), hit anything; otherwise as `first`."""
        face: np.ndarray = self._scene.run(origins, directions, query="OCCLUDED")
        return face >= 0

    def all_blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """As `blocked`, on all cores."""
        size = self._settings.chunk
        parts = self._threads.map(
            lambda start: self.blocked(origins[start : start + size], directions[start : start + size]),
            range(0, len(origins), size),
        )
        return np.concatenate([np.zeros(0, bool), *parts])

    def _cast(self, origins: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
        result: dict[str, np.ndarray] = self._scene.run(origins, directions, query="INTERSECT", output=True)
        return result
