"""The mesh made ready for rays, once a run: moved to its unit cube, with Embree's BVH and its faces' geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.mesh import Mesh


@dataclass(frozen=True)
class Scene3D:
    """What rays meet. The command makes one with `build` and hands it on: its BVH is the dearest part of a mesh.

    Attributes:
        mesh: in the scene's own axes and units.
        frame: from there to the unit cube.
        caster: Embree over the mesh in the unit cube.
        face_normals: (F, 3) float64 unit normals by the faces' winding; zero for faces of no area.
        uv_scale: (F,) float64, length on the texture, in parts of its side, per length in the unit cube; 0 for faces of
            no area in space or on the texture, and where the mesh has no UVs.
    """

    mesh: Mesh
    frame: Frame3D
    caster: Raycaster
    face_normals: np.ndarray
    uv_scale: np.ndarray

    @classmethod
    def build(cls, mesh: Mesh) -> Scene3D:
        """The scene of a mesh, with UVs or without.

        Raises:
            MemoryError: there is none for the BVH.
        """
        frame = Frame3D.around(mesh)
        return cls(mesh, frame, Raycaster(mesh, frame), *_geometry(mesh, frame))

    def with_uvs(self, uvs: np.ndarray) -> Scene3D:
        """The same mesh with other UVs (F, 3, 2); the BVH is shared."""
        mesh = replace(self.mesh, uvs=uvs)
        return replace(self, mesh=mesh, uv_scale=_geometry(mesh, self.frame)[1])

    def corners(self) -> np.ndarray:
        """(F, 3, 3) float64 positions of the faces' corners in the unit cube."""
        return self.frame.normalise(self.mesh.vertices)[self.mesh.faces]


def _geometry(mesh: Mesh, frame: Frame3D) -> tuple[np.ndarray, np.ndarray]:
    corners = frame.normalise(mesh.vertices)[mesh.faces]
    return face_geometry(corners, np.zeros((len(corners), 3, 2)) if mesh.uvs is None else mesh.uvs)


def face_geometry(corners: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`face_normals` (F, 3) and `uv_scale` (F,) of faces with corners (F, 3, 3) and UVs (F, 3, 2); see `Scene3D`."""
    edges = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(cross, axis=1)
    sides = uvs[:, 1:] - uvs[:, :1]
    uv_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    solid = area > 0.0
    safe = np.where(solid, area, 1.0)
    return cross / safe[:, None], np.sqrt(np.where(solid, uv_area / safe, 0.0))
