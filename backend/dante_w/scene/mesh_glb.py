"""Binary glTF 2.0 (.glb): every triangle of the scene, with its nodes' transforms applied.

By hand: trimesh 5.2 drops UVs of parts without a material and reads damaged files as if
they were whole; pygltflib reads the JSON alone and leaves accessors and nodes, most of this file, to its user.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.scene.mesh_obj import Arrays

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_TRIANGLES = 4


def parse_glb(data: bytes) -> Arrays:
    """Vertices float64 (V, 3) in glTF's axes (y up), faces int64 (F, 3), UVs float64 (F, 3, 2) or None, normals (F, 3, 3) or
    None.

    UVs are TEXCOORD_0 with v turned to grow upwards. Primitives of points and lines are skipped, one
    without UVs gets (0, 0) where others have them, and likewise without normals. Skins and morph targets are not applied.

    Raises:
        BadInput: a sentence without the file's name. ValueError, KeyError, IndexError, TypeError,
            struct.error, RecursionError: the file is malformed.
    """
    document, binary = _chunks(data)
    extensions = [*document.get("extensionsRequired", []), *document.get("extensionsUsed", [])]
    parts: list[Arrays] = []
    for mesh, matrix in _placed_meshes(document):
        for primitive in document["meshes"][mesh]["primitives"]:
            if any(name in primitive.get("extensions", {}) for name in _COMPRESSED):
                raise BadInput("the mesh is compressed (Draco or meshopt); export it without compression.")
            part = _primitive(document, binary, primitive)
            if part is not None:
                parts.append(_moved(part, matrix))
    if any(name in extensions for name in _COMPRESSED[1:]):
        raise BadInput("the mesh is compressed (Draco or meshopt); export it without compression.")
    if not parts:
        raise BadInput("the mesh has no faces; export it with its faces.")
    starts = np.cumsum([0] + [len(part[0]) for part in parts])
    vertices = np.concatenate([part[0] for part in parts])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, starts[:-1], strict=True)])
    counts = [len(part[1]) for part in parts]
    uvs, normals = (_joined([part[which] for part in parts], counts, which) for which in (2, 3))
    return vertices, faces, uvs, normals


def _joined(arrays: list[np.ndarray | None], counts: list[int], width: int) -> np.ndarray | None:
    """(F, 3, width) what the parts have at their faces' corners, 0 where one has none; None where none has any."""
    if all(array is None for array in arrays):
        return None
    empty = (np.zeros((count, 3, width)) for count in counts)
    return np.concatenate(
        [none if array is None else array for none, array in zip(empty, arrays, strict=True)]
    )


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    if data[:4] != b"glTF":
        raise BadInput("is not a binary glTF file; export it as .glb.")
    if struct.unpack_from("<I", data, 4)[0] != 2:
        raise BadInput("is not glTF version 2; export it with a newer program.")
    document, binary = None, b""
    position = 12
    while position + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, position)
        content = data[position + 8 : position + 8 + length]
        if len(content) != length:
            raise ValueError("the file ends early")
        if kind == b"JSON" and document is None:
            document = json.loads(content)
        elif kind == b"BIN\0" and not binary:
            binary = content
        position += 8 + length + -length % 4
    if not isinstance(document, dict):
        raise ValueError("no JSON chunk")
    return document, binary


def _placed_meshes(document: dict[str, Any]) -> list[tuple[int, np.ndarray]]:
    """(mesh, 4x4 world matrix) of every node that shows a mesh."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    if scenes:
        roots = scenes[document.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    meshes: list[tuple[int, np.ndarray]] = []
    visited: set[int] = set()
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    while waiting:
        index, parent = waiting.pop()
        if index in visited or index < 0:
            raise ValueError("a node stands below itself or below two others")
        visited.add(index)
        matrix = parent @ _local_matrix(nodes[index])
        if "mesh" in nodes[index]:
            meshes.append((nodes[index]["mesh"], matrix))
        waiting += [(child, matrix) for child in reversed(nodes[index].get("children", []))]
    return meshes


def _local_matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = (float(value) for value in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    scale = np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64).reshape(3)
    matrix[:3, :3] = np.array(rotation) * scale
    matrix[:3, 3] = np.array(node.get("translation", (0.0, 0.0, 0.0)), np.float64).reshape(3)
    return matrix


def _primitive(document: dict[str, Any], binary: bytes, primitive: dict[str, Any]) -> Arrays | None:
    mode = primitive.get("mode", _TRIANGLES)
    if mode < _TRIANGLES:
        return None  # points and lines
    if mode != _TRIANGLES:
        raise BadInput("the mesh has triangle strips or fans; export it as plain triangles.")
    attributes = primitive["attributes"]
    vertices = _accessor(document, binary, attributes["POSITION"], 3)
    if "indices" in primitive:
        faces = _accessor(document, binary, primitive["indices"], 1).astype(np.int64).reshape(-1, 3)
    else:
        faces = np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise BadInput("a face names a vertex that is not there; export the mesh again.")
    uvs, normals = None, None
    if "TEXCOORD_0" in attributes:
        uvs = _accessor(document, binary, attributes["TEXCOORD_0"], 2)
        uvs = np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)[faces]
    if "NORMAL" in attributes:
        normals = _accessor(document, binary, attributes["NORMAL"], 3)[faces]
    return vertices, faces, uvs, normals


def _accessor(document: dict[str, Any], binary: bytes, index: int, width: int) -> np.ndarray:
    """The values of an accessor, float64 (N, width); normalised integers are scaled to [-1, 1]."""
    accessor = document["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise BadInput("the mesh has sparse data; export it without sparse accessors.")
    if _WIDTHS[accessor["type"]] != width:
        raise ValueError("an attribute of another width")
    view = document["bufferViews"][accessor["bufferView"]]
    if view["buffer"] != 0 or "uri" in document["buffers"][0]:
        raise BadInput("the mesh keeps its data in another file; export it as one .glb.")
    kind = np.dtype(_KINDS[accessor["componentType"]])
    start = view.get("byteOffset", 0)
    if min(start, view["byteLength"]) < 0:
        raise ValueError("a view that begins before its buffer")
    data = binary[start : start + view["byteLength"]]
    stride = view.get("byteStride") or kind.itemsize * width
    shape = (accessor["count"], width)
    values = np.ndarray(shape, kind, data, accessor.get("byteOffset", 0), (stride, kind.itemsize)).astype(
        np.float64
    )
    if accessor.get("normalized") and kind.kind != "f":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    return values


def _moved(part: Arrays, matrix: np.ndarray) -> Arrays:
    """The part in world space; a mirroring matrix turns the faces' corners round, as glTF requires."""
    vertices, faces, uvs, normals = part
    if not np.isfinite(matrix).all():
        raise BadInput("a node's transform is not finite; export the mesh again.")
    linear = matrix[:3, :3]
    vertices = vertices @ linear.T + matrix[:3, 3]
    mirrored = np.linalg.det(linear) < 0.0
    if normals is not None:  # as cross products turn, back to the outer side where mirrored
        cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
        normals = normals @ (-cofactors if mirrored else cofactors).T
    if mirrored:
        faces = faces[:, ::-1]
        uvs, normals = (None if each is None else each[:, ::-1] for each in (uvs, normals))
    return vertices, faces, uvs, normals
