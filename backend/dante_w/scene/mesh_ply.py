"""PLY, ASCII and binary of either byte order, with polygons, UVs per vertex or per face, and normals per vertex.

By hand: trimesh 5.2 reads no binary file with polygons of several sizes and no UVs of
faces, and takes ASCII files that were cut short for whole.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.scene.mesh_fan import fan
from dante_w.scene.mesh_obj import Arrays, scan

_KINDS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))


@dataclass
class _Element:
    """One element of the header. `properties`: name, kind, and the kind of the count of a list or None."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


#: A column of an element: its values laid end to end, and for a list how many each row has.
_Column = tuple[np.ndarray, np.ndarray | None]


def parse_ply(data: bytes) -> Arrays:
    """Vertices float64 (V, 3), faces int64 (F, 3), UVs float64 (F, 3, 2) or None, normals (F, 3, 3) or None.

    UVs come from the faces' `texcoord` list or the vertices' s t, u v, texture_u texture_v; normals from nx ny nz.

    Raises:
        BadInput: a sentence without the file's name. ValueError, KeyError, IndexError, TypeError: the
            file is malformed.
    """
    order, elements, body = _header(data)
    if order == "":  # from here on, ASCII is a binary file of doubles
        body = scan(body, np.float64, "the mesh holds words that are not numbers").tobytes()
    columns: dict[str, dict[str, _Column]] = {}
    position = 0
    for element in elements:
        columns[element.name], position = _rows(element, body, position, order)
    if "vertex" not in columns:
        raise BadInput("the mesh has no vertices; export it again.")
    vertex, face = columns["vertex"], columns.get("face", {})
    vertices = np.stack([vertex[axis][0] for axis in "xyz"], axis=1).astype(np.float64)
    indices, sizes = face.get("vertex_indices") or face.get("vertex_index") or (np.empty(0), np.empty(0))
    if sizes is None or len(sizes) == 0:
        raise BadInput("the mesh has no faces (a point cloud, perhaps); export it with its faces.")
    if indices.dtype.kind == "f" and not (np.abs(indices) < 2.0**53).all():  # NaN is no index on any machine
        raise BadInput("a face names a vertex that is not there; export the mesh again.")
    triangles = fan(sizes)
    faces = indices.astype(np.int64)[triangles]
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise BadInput("a face names a vertex that is not there; export the mesh again.")
    normals = None
    if all(axis in vertex for axis in ("nx", "ny", "nz")):
        with np.errstate(over="ignore"):
            columns_xyz = [vertex[axis][0].astype(np.float32) for axis in ("nx", "ny", "nz")]
        normals = np.stack(columns_xyz, axis=1)[faces]
    if "texcoord" in face:
        return vertices, faces, _face_uvs(face["texcoord"], sizes)[triangles], normals
    for u, v in _UV_NAMES:
        if u in vertex and v in vertex:
            uvs = np.stack([vertex[u][0], vertex[v][0]], axis=1).astype(np.float64)
            return vertices, faces, uvs[faces], normals
    return vertices, faces, None, normals


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    """Byte order ("" for ASCII), elements, and the body."""
    end = data.find(b"end_header")
    stop = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0:
        raise BadInput("is not a PLY file; export the mesh again.")
    elements: list[_Element] = []
    order = None
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format":
            order = _ORDERS[words[1]]
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2])))
            if elements[-1].count < 0:
                raise ValueError("negative count")
        elif words[0] == "property" and words[1] == "list":
            elements[-1].properties.append((words[4], _KINDS[words[3]], _KINDS[words[2]]))
        elif words[0] == "property":
            elements[-1].properties.append((words[2], _KINDS[words[1]], None))
        else:
            raise ValueError(line)
    if order is None:
        raise ValueError("no format")
    if stop < 0:  # old Macintosh line ends
        stop = end + len(b"end_header")
    return order, elements, data[stop + 1 :]


def _rows(element: _Element, body: bytes, position: int, order: str) -> tuple[dict[str, _Column], int]:
    """All rows of an element, and the position behind them.

    Rows are first taken to have lists as long as the first row's, which makes them one numpy view; where
    that proves wrong, they are walked one by one.
    """
    if element.count == 0 or not element.properties:
        return {name: (np.empty(0), np.empty(0, np.int64)) for name, _, _ in element.properties}, position
    kinds = [np.dtype(order + kind if order else "f8") for _, kind, _ in element.properties]
    counts = [
        np.dtype(order + count if order else "f8") if count else None for _, _, count in element.properties
    ]
    offsets, lengths, end = _walk(kinds, counts, body, position, 1)
    stride = end - position
    columns: dict[str, _Column] = {}
    if position + stride * element.count <= len(body):
        for (name, _, _), kind, count, offset, length in zip(
            element.properties, kinds, counts, offsets[0], lengths[0], strict=True
        ):
            if count is not None:
                count_offset = offset - count.itemsize
                list_lengths = np.ndarray((element.count,), count, body, count_offset, (stride,))
                if not (list_lengths == length).all():
                    break
            values = np.ndarray((element.count, length), kind, body, offset, (stride, kind.itemsize))
            columns[name] = values.reshape(-1), count and np.full(element.count, length, np.int64)
        else:
            return columns, position + stride * element.count
    offsets, lengths, end = _walk(kinds, counts, body, position, element.count)
    octets = np.frombuffer(body, np.uint8)
    for i, ((name, _, _), kind) in enumerate(zip(element.properties, kinds, strict=True)):
        sizes = lengths[:, i]
        first = np.repeat(offsets[:, i] - (np.cumsum(sizes) - sizes) * kind.itemsize, sizes)
        places = first + np.arange(len(first)) * kind.itemsize
        values = octets[places[:, None] + np.arange(kind.itemsize)].view(kind).reshape(-1)
        columns[name] = values, None if counts[i] is None else sizes
    return columns, end


def _walk(
    kinds: list[np.dtype], counts: list[np.dtype | None], body: bytes, position: int, rows: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Where each property of each row starts, how many values it has (both (rows, P)), and the end."""
    steps = [
        (
            kind.itemsize,
            None if count is None else struct.Struct((count.str[0].replace("|", "=")) + count.char),
        )
        for kind, count in zip(kinds, counts, strict=True)
    ]
    offsets: list[int] = []
    lengths: list[int] = []
    for _ in range(rows):
        for size, count in steps:
            length = 1
            if count is not None:
                number = count.unpack_from(body, position)[0]
                length = int(number)
                if length != number or length < 0:
                    raise ValueError("a list of no whole length")
                position += count.size
            offsets.append(position)
            lengths.append(length)
            position += size * length
            if position > len(body):
                raise ValueError("the file ends early")
    shape = (rows, len(kinds))
    return np.array(offsets, np.int64).reshape(shape), np.array(lengths, np.int64).reshape(shape), position


def _face_uvs(texcoord: _Column, sizes: np.ndarray) -> np.ndarray:
    """UV of every corner (C, 2) from the faces' lists of u v u v ...; faces whose list is empty get (0, 0)."""
    values, lengths = texcoord
    if lengths is None or not ((lengths == 2 * sizes) | (lengths == 0)).all():
        raise BadInput("a face has not two texture coordinates per corner; export the mesh again.")
    uvs = np.zeros((int(sizes.sum()), 2))
    uvs[np.repeat(lengths > 0, sizes)] = values.reshape(-1, 2)
    return uvs
