"""Triangle meshes with UVs and normals, and the OBJ files that carry them between add-on and backend.

Files of users are read by `dante_w.scene.mesh`; `read_obj` here takes only what `write_obj` has written.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Triangles:
    """A triangle mesh, indexed as in an OBJ file but from 0.

    Attributes:
        vertices: (V, 3) float64.
        corners: (F, 3) vertex of each triangle corner.
        uvs, uv_corners: (T, 2) float64 and (F, 3), or both None for a mesh without UVs. v points up.
        normals, normal_corners: (N, 3) float64 of unit length and (F, 3), or both None for a mesh without normals.
    """

    vertices: np.ndarray
    corners: np.ndarray
    uvs: np.ndarray | None = None
    uv_corners: np.ndarray | None = None
    normals: np.ndarray | None = None
    normal_corners: np.ndarray | None = None


def write_obj(path: Path, mesh: Triangles) -> None:
    """Write an OBJ whose decimal numbers read back as the same float64, in as few digits as that takes.

    Raises:
        OSError: the file cannot be written.
    """
    with open(path, "w", encoding="ascii", newline="\n") as target:
        target.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.vertices.tolist())
        columns, corner = [mesh.corners], "{}"
        if mesh.uvs is not None and mesh.uv_corners is not None:
            target.writelines(f"vt {u!r} {v!r}\n" for u, v in mesh.uvs.tolist())
            columns.append(mesh.uv_corners)
            corner += "/{}"
        if mesh.normals is not None and mesh.normal_corners is not None:
            target.writelines(f"vn {x!r} {y!r} {z!r}\n" for x, y, z in mesh.normals.tolist())
            columns.append(mesh.normal_corners)
            corner += "//{}" if mesh.uvs is None else "/{}"
        line = f"f {corner} {corner} {corner}\n"
        rows = np.stack(columns, axis=2).reshape(len(mesh.corners), -1) + 1
        target.writelines(line.format(*row) for row in rows.tolist())


def read_obj(path: Path) -> Triangles:
    """Vertices and UVs of a file that `write_obj` has written; normals are left out.

    Raises:
        OSError, ValueError, IndexError: the file is missing or was written by something else.
    """
    vertices, uvs, corners, uv_corners = [], [], [], []
    with open(path, encoding="ascii") as source:
        for line in source:
            keyword, *words = line.split()
            if keyword == "v":
                vertices.append([float(word) for word in words])
            elif keyword == "vt":
                uvs.append([float(word) for word in words])
            elif keyword == "f":
                indices = [[int(index) - 1 for index in word.split("/")[:2]] for word in words]
                corners.append([vertex for vertex, _ in indices])
                uv_corners.append([uv for _, uv in indices])
    return Triangles(np.array(vertices), np.array(corners), np.array(uvs), np.array(uv_corners))
