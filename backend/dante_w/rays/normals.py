"""Shading normals: how the surface that a mesh stands for is turned at the corners of its faces.

A mesh's own normals are taken where it has some. Where it has none it is a scan as a rule, whose faces lie a little askew
of a smooth surface. There a corner's normal is the mean over the faces around its vertex that are turned by less than the
crease angle from its own, weighted by their angles (Thürmer and Wüthrich, "Computing vertex normals from polygonal
facets", 1998).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel
from dante_w.scene.mesh import Mesh


@dataclass(frozen=True)
class NormalSettings:
    """Which faces around a vertex share a smooth normal."""

    #: Degrees: faces that are turned further from each other meet in an edge. Half a right angle keeps the edges of what
    #: is built and smooths the noise of a scan.
    crease: float = 45.0
    #: Faces around a vertex that are averaged at most: a fan of a million would take as many steps, squared.
    most_faces: int = 64


NORMALS = NormalSettings()


def corner_normals(
    mesh: Mesh, corners: np.ndarray, face_normals: np.ndarray, settings: NormalSettings = NORMALS
) -> np.ndarray:
    """(F, 3, 3) float32 unit normals of the faces' corners, on the side to which the face's own points: the mesh's where it
    has one, else made from the faces around, whichever way these are wound; zero at faces of no area.

    Args:
        corners: (F, 3, 3) positions, in any frame that is not rotated against the mesh's.
        face_normals: (F, 3) unit normals, zero for faces of no area.
    """
    if mesh.normals is None:
        return _smooth(mesh, corners, face_normals, settings)
    normals = np.array(mesh.normals, np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals /= np.where(length > 0.0, length, 1.0)
        cosine = np.einsum("fcx,fx->fc", normals, face_normals)
        normals *= np.sign(cosine)[:, :, None]
    valid = np.abs(cosine) > 0.0  # neither 0 nor NaN
    if not valid.all():
        normals[~valid] = _smooth(mesh, corners, face_normals, settings)[~valid]
    return normals


def _smooth(
    mesh: Mesh, corners: np.ndarray, face_normals: np.ndarray, settings: NormalSettings
) -> np.ndarray:
    place = _places(mesh.vertices)[mesh.faces].reshape(-1)
    order = np.argsort(place, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(place[order]) != 0, True])
    angles = np.empty(len(order), np.float32)
    _angles(corners, angles)
    normals = np.empty((len(corners), 3, 3), np.float32)
    crease = math.cos(math.radians(settings.crease))
    _add_up(order, first, np.asarray(face_normals, np.float32), angles, crease, settings.most_faces, normals)
    return normals


def _places(vertices: np.ndarray) -> np.ndarray:
    """(V,) a number for each vertex, the same for those at the same place: files repeat vertices where UVs have seams."""
    number = np.zeros(len(vertices), np.uint64)
    for column in (np.ascontiguousarray(vertices, np.float64) + 0.0).view(np.uint64).T:  # -0 is 0
        number ^= column
        for shift, factor in ((33, 0xFF51AFD7ED558CCD), (33, 0xC4CEB9FE1A85EC53), (33, 1)):  # MurmurHash3's
            number ^= number >> np.uint64(shift)
            number *= np.uint64(factor)
    return np.unique(number, return_inverse=True)[1].astype(np.int32)


@njit_parallel
def _angles(corners: np.ndarray, angles: np.ndarray) -> None:
    """Fill in (3 F,) the angles of faces (F, 3, 3) at their corners, 0 where a side has no length."""
    for f in prange(len(corners)):
        for c in range(3):
            a, b = corners[f, (c + 1) % 3] - corners[f, c], corners[f, (c + 2) % 3] - corners[f, c]
            lengths = math.sqrt((a**2).sum() * (b**2).sum())
            cosine = (a * b).sum() / lengths if lengths > 0.0 else 1.0
            angles[3 * f + c] = math.acos(min(max(cosine, -1.0), 1.0))


@njit_parallel
def _add_up(
    order: np.ndarray,
    first: np.ndarray,
    face_normals: np.ndarray,
    angles: np.ndarray,
    crease: float,
    most_faces: int,
    normals: np.ndarray,
) -> None:
    """Fill in the normals (F, 3, 3); `crease` is the cosine of the crease angle. `order` (3 F,) has the corners vertex after vertex, from `first[v]` to `first[v + 1]`."""
    for v in prange(len(first) - 1):
        step = max((first[v + 1] - first[v]) // most_faces, 1)
        for i in range(first[v], first[v + 1]):
            corner = order[i]
            face_normal = face_normals[corner // 3]
            x, y, z = 0.0, 0.0, 0.0
            for j in range(first[v], first[v + 1], step):
                n, weight = face_normals[order[j] // 3], angles[order[j]]
                cosine = face_normal[0] * n[0] + face_normal[1] * n[1] + face_normal[2] * n[2]
                if abs(cosine) >= crease:
                    weight = weight if cosine > 0.0 else -weight  # a face wound the other way
                    x, y, z = x + weight * n[0], y + weight * n[1], z + weight * n[2]
            length = math.sqrt(x * x + y * y + z * z)
            out = normals[corner // 3, corner % 3]
            if length > 0.0:
                out[0], out[1], out[2] = x / length, y / length, z / length
            else:
                out[:] = face_normal
