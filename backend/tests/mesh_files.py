"""Mesh files made by hand, for the tests of their readers."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.scene.mesh import Mesh, read_mesh

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
CORNERS = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
FANS = [[0, 1, 2], [0, 2, 3]]


def read(folder: Path, name: str, content: str | bytes) -> Mesh:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_mesh(path)


def refused(folder: Path, name: str, content: str | bytes) -> str:
    with pytest.raises(BadInput) as caught:
        read(folder, name, content)
    message = str(caught.value)
    assert message.startswith(str(folder / name)) and "\n" not in message and message.endswith(".")
    return message


def same(mesh: Mesh, vertices: list, faces: list, uvs: list | np.ndarray | None) -> None:
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.int32)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)
    if uvs is None:
        assert mesh.uvs is None
    else:
        np.testing.assert_array_equal(mesh.uvs, uvs)


def square_uvs() -> np.ndarray:
    return np.array(CORNERS)[np.array(FANS)]


def v_lines(vertices: list, keyword: str = "v") -> str:
    return "".join(f"{keyword} {' '.join(map(str, vertex))}\n" for vertex in vertices)


ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {"float": "f", "double": "d", "uchar": "B", "int": "i", "uint": "I", "short": "h", "ushort": "H"}


def ply(form: str, elements: list[tuple[str, list[str], list[list]]]) -> bytes:
    """A PLY file; a row holds a number per property, or a list for a list property."""
    header, body = f"ply\nformat {form} 1.0\ncomment by hand\n", b""
    for name, properties, rows in elements:
        header += f"element {name} {len(rows)}\n" + "".join(f"property {text}\n" for text in properties)
        for row in rows:
            words: list[bytes] = []
            for text, value in zip(properties, row, strict=True):
                kinds = text.split()[:-1]
                values = value if kinds[0] == "list" else [value]
                pairs = [(kinds[1], len(values))] if kinds[0] == "list" else []
                pairs += [(kinds[-1], item) for item in values]
                if form == "ascii":
                    words += [str(item).encode() for _, item in pairs]
                else:
                    words += [struct.pack(ORDERS[form] + CODES[kind], item) for kind, item in pairs]
            body += b" ".join(words) + b"\n" if form == "ascii" else b"".join(words)
    return (header + "end_header\n").encode() + body


XYZ = ["float x", "float y", "float z"]
LIST = ["list uchar int vertex_indices"]


def glb(document: dict, binary: bytes = b"") -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def square_glb(index: str = "<u2", uv: str = "<f4", **changes: object) -> tuple[dict, bytes]:
    """A document and its bytes: positions and UVs interleaved, then indices. `changes` go to the primitive."""
    codes = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
    scale = 1 if "f" in uv else np.iinfo(uv).max
    row = np.dtype(
        {"names": ["p", "t"], "formats": [("<f4", 3), (uv, 2)], "offsets": [0, 12], "itemsize": 20}
    )
    table = np.zeros(4, row)
    table["p"] = SQUARE
    table["t"] = [[u * scale, (1 - v) * scale] for u, v in CORNERS]  # glTF's v grows downwards
    indices = np.array(FANS, index).tobytes()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 0, "byteOffset": 12, "componentType": codes[uv[1:]], "count": 4, "type": "VEC2"},
        {"bufferView": 1, "componentType": codes[index[1:]], "count": 6, "type": "SCALAR"},
    ]
    if scale != 1:
        accessors[1]["normalized"] = True
    views = [
        {"buffer": 0, "byteLength": 80, "byteStride": 20},
        {"buffer": 0, "byteOffset": 80, "byteLength": len(indices)},
    ]
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, **changes}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 80 + len(indices)}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    return document, table.tobytes() + indices
