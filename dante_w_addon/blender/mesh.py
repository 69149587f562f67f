"""The evaluated mesh as arrays.

Read by hand rather than with Blender's exporters: those can be disabled, and they write float32, in which a
geo-referenced mesh (coordinates of 1e7) loses its shape.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..contract.errors import BadInput
from ..contract.triangles import Triangles


def evaluated_triangles(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Triangles:
    """`obj` as the viewport shows it: modifiers and world transform applied, in float64.

    Raises:
        BadInput: nothing is left to texture.
    """
    if obj.mode == "EDIT":
        obj.update_from_editmode()
        depsgraph.update()
    evaluated_obj = obj.evaluated_get(depsgraph)
    mesh = evaluated_obj.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        if count == 0:
            raise BadInput(f"{obj.name} has no faces; choose a mesh with faces.")
        local = _read(mesh.vertices, "co", len(mesh.vertices), 3, np.float32)
        corners = _read(mesh.loop_triangles, "vertices", count, 3, np.int32)
        loops = _read(mesh.loop_triangles, "loops", count, 3, np.int32)
        layer = render_uv_map(mesh)
        corner_uvs = None if layer is None else _read(layer.uv, "vector", len(mesh.loops), 2, np.float32)
        corner_normals = None
        if mesh.normals_domain != "FACE":
            corner_normals = _read(mesh.corner_normals, "vector", len(mesh.loops), 3, np.float32)
        matrix = np.array(evaluated_obj.matrix_world, np.float64)
    finally:
        evaluated_obj.to_mesh_clear()
    vertices = local.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(vertices).all():
        raise BadInput(f"{obj.name} has vertices that are not finite; repair the mesh.")
    turn = matrix[:3, :3]
    cofactors = np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]])  # as normals turn
    if np.linalg.det(turn) < 0.0:  # a mirror turns faces inside out
        corners, loops, cofactors = corners[:, ::-1], loops[:, ::-1], -cofactors
    normals = normal_corners = None
    if corner_normals is not None:
        steps = np.rint(32767.0 * corner_normals).astype(np.int64) + 32768
        normals, normal_corners = _shared(corner_normals, steps @ (1 << 34, 1 << 17, 1), loops)
        normals = normals @ cofactors.T
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    if corner_uvs is None:
        return Triangles(vertices, corners, None, None, normals, normal_corners)
    inside = np.clip(corner_uvs, 0.0, 1.0)  # modifiers leave the unit square by a rounding error
    corner_uvs = np.where(np.abs(inside - corner_uvs) < 1e-5, inside, corner_uvs)
    keys = np.ascontiguousarray(corner_uvs).view(np.uint64).ravel()
    uvs, uv_corners = _shared(corner_uvs, keys, loops)  # seams are found by it
    return Triangles(vertices, corners, uvs, uv_corners, normals, normal_corners)


def _shared(values: np.ndarray, keys: np.ndarray, loops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What corners have (L, width), those of the same key (L,) once, as float64; and which of them `loops` (F, 3) have."""
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return values[first].astype(np.float64), inverse.ravel()[loops]


def render_uv_map(mesh: bpy.types.Mesh) -> bpy.types.MeshUVLoopLayer | None:
    """The UV map that renders use."""
    return next((layer for layer in mesh.uv_layers if layer.active_render), None)


def _read(collection, attribute: str, rows: int, columns: int, kind: type) -> np.ndarray:
    flat = np.empty(rows * columns, kind)
    collection.foreach_get(attribute, flat)
    return flat.reshape(rows, columns)
