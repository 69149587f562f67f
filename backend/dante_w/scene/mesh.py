"""The triangle mesh, read from OBJ, PLY or GLB and written as OBJ.

Coordinates are the file's own, never rotated or scaled (a GLB keeps glTF's y up, with its nodes applied);
photos' poses refer to the same axes. UVs follow Blender and OBJ: v grows upwards, (0, 0) is the lower left
corner of the texture. They are never wrapped, clipped or otherwise changed.
"""

from __future__ import annotations

import errno
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dante_w.contract import triangles
from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.contract.triangles import Triangles
from dante_w.scene.mesh_glb import parse_glb
from dante_w.scene.mesh_obj import parse_obj
from dante_w.scene.mesh_ply import parse_ply

_PARSERS = {".obj": parse_obj, ".ply": parse_ply, ".glb": parse_glb}
_BROKEN = (
    ValueError,  # with UnicodeDecodeError and JSONDecodeError
    TypeError,
    IndexError,
    KeyError,
    AttributeError,
    OverflowError,
    RecursionError,
    struct.error,
)


@dataclass(frozen=True)
class Mesh:
    """Triangles, in the file's own order, axes and units; polygons are cut into fans.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int32 indices of vertices.
        uvs: (F, 3, 2) float64 per corner, v up, or None; (0, 0) at a corner without where others have one.
        normals: (F, 3, 3) float32 per corner, or None; as the file has them, of any length and not always finite, (0, 0, 0)
            where there is none.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None
    normals: np.ndarray | None = None


def read_mesh(path: Path) -> Mesh:
    """Read a mesh by its file ending: .obj, .ply (ASCII and binary) or .glb.

    Raises:
        BadInput: the file is missing, malformed, of another kind, has no faces or has numbers that are
            not finite.
        OutOfRoom: the mesh does not fit in memory.
    """
    path = Path(path)
    parse = _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise BadInput(f"{path}: meshes of this kind are not read; export the mesh as .obj, .ply or .glb.")
    try:
        arrays = parse(path.read_bytes())
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise BadInput(f"{path}: there is no such mesh; correct its path or copy it there.") from error
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); check the file.") from error
    except MemoryError as error:
        raise OutOfRoom(f"{path}: does not fit in memory; use a mesh with fewer faces.") from error
    except _BROKEN as error:
        kind = path.suffix[1:].upper()
        raise BadInput(f"{path}: is not a well-formed {kind} mesh; export it again.") from error
    return checked(path, *arrays)


def checked(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    uvs: np.ndarray | None,
    normals: np.ndarray | None = None,
) -> Mesh:
    """A Mesh of these arrays; shapes as in `Mesh`, of any dtype.

    Raises:
        BadInput: they do not make one; names `path`.
    """
    if len(faces) == 0:
        raise BadInput(f"{path}: the mesh has no faces; export it with its faces.")
    if len(vertices) > np.iinfo(np.int32).max or len(faces) > np.iinfo(np.int32).max:
        raise BadInput(f"{path}: the mesh is too large; decimate it.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise BadInput(f"{path}: face {bad} names a vertex that is not there; export the mesh again.")
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise BadInput(f"{path}: vertex {bad} is not finite; remove it and export the mesh again.")
    if uvs is not None and not np.isfinite(uvs).all():
        bad = int(np.argmin(np.isfinite(uvs).all(axis=(1, 2))))
        raise BadInput(f"{path}: face {bad} has a UV that is not finite; unwrap the mesh again.")
    if normals is not None:
        with np.errstate(over="ignore"):
            normals = np.ascontiguousarray(normals, np.float32)
    return Mesh(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
        None if uvs is None else np.ascontiguousarray(uvs, np.float64),
        normals,
    )


def write_obj(path: Path, mesh: Mesh) -> None:
    """Write OBJ. Every number reads back as the same float64, in as few digits as that takes; vertices
    and faces keep their order, equal UVs and normals are written once.

    Raises:
        OutOfRoom: the disk is full.
        BadInput: the file cannot be created.
    """
    uvs = (None, None) if mesh.uvs is None else _table(mesh.uvs)
    normals = (None, None) if mesh.normals is None else _table(mesh.normals)
    try:
        triangles.write_obj(path, Triangles(mesh.vertices, mesh.faces, *uvs, *normals))
    except OSError as error:
        if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", None)):
            if not os.path.islink(path):
                Path(path).unlink(missing_ok=True)
            raise OutOfRoom(f"{path}: the disk is full; free some space.") from error
        raise BadInput(
            f"{path}: cannot be written ({error.strerror}); choose a folder you may write to."
        ) from error


def _table(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What corners have (F, 3, width): the distinct rows, and which of them each corner (F, 3) has."""
    table, index = unique_rows(values.reshape(-1, values.shape[2]))
    return table, index.reshape(-1, 3)


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct rows (N, width) as float64, bit for bit, in order of first use, and for each row the index
    of its like: `table[index] == rows`."""
    rows = np.ascontiguousarray(rows, np.float64)
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rows[first[order]], rank[inverse]
