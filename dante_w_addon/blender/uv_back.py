"""UVs that the backend made, brought back to the object."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..contract.triangles import read_obj

UV_MAP = "DANTE-W"


def bring_back(obj: bpy.types.Object, path: Path) -> bpy.types.Object:
    """Give `obj` the UVs in the OBJ at `path`, or make a new object of it where they do not fit.

    They fit where the exported mesh was the object's own (no modifier changed its faces), in its order, and no
    seam runs through a quad or n-gon.

    Returns:
        The object that carries the UVs.

    Raises:
        OSError, ValueError, IndexError: the file cannot be read.
    """
    unwrapped_mesh = read_obj(path)
    corner_uvs = unwrapped_mesh.uvs[unwrapped_mesh.uv_corners]
    loops = _matching_loops(obj, unwrapped_mesh.corners)
    if loops is not None:
        layer_uvs = np.zeros((len(obj.data.loops), 2))
        layer_uvs[loops.ravel()] = corner_uvs.reshape(-1, 2)
        if np.allclose(layer_uvs[loops], corner_uvs, atol=1e-6):
            layer = obj.data.uv_layers.get(UV_MAP) or obj.data.uv_layers.new(name=UV_MAP, do_init=False)
            layer.uv.foreach_set("vector", layer_uvs.astype(np.float32).ravel())
            layer.active = layer.active_render = True
            return obj
    return _new_object(obj, unwrapped_mesh.vertices, unwrapped_mesh.corners, corner_uvs)


def _matching_loops(obj: bpy.types.Object, corners: np.ndarray) -> np.ndarray | None:
    """Loop of each triangle corner, where `corners` are the object's own triangles, else None."""
    data = obj.data
    data.calc_loop_triangles()
    if len(data.loop_triangles) != len(corners):
        return None
    vertices = np.empty(corners.size, np.int32)
    data.loop_triangles.foreach_get("vertices", vertices)
    loops = np.empty(corners.size, np.int32)
    data.loop_triangles.foreach_get("loops", loops)
    vertices, loops = vertices.reshape(-1, 3), loops.reshape(-1, 3)
    if obj.matrix_world.determinant() < 0.0:  # the export turned the faces of a mirrored object
        vertices, loops = vertices[:, ::-1], loops[:, ::-1]
    return loops if np.array_equal(vertices, corners) else None


def _new_object(
    obj: bpy.types.Object, vertices: np.ndarray, corners: np.ndarray, corner_uvs: np.ndarray
) -> bpy.types.Object:
    data = bpy.data.meshes.new(f"{obj.data.name} unwrapped")
    data.from_pydata(vertices.tolist(), [], corners.tolist())
    layer = data.uv_layers.new(name=UV_MAP, do_init=False)
    layer.uv.foreach_set("vector", corner_uvs.astype(np.float32).ravel())
    new_obj = bpy.data.objects.new(f"{obj.name} unwrapped", data)
    for collection in obj.users_collection:
        collection.objects.link(new_obj)
    return new_obj
