"""Wavefront OBJ: v, vt, vn and f lines; everything else is skipped. Fast enough for a million faces."""

from __future__ import annotations

import numpy as np

from dante_w.contract.errors import BadInput
from dante_w.scene.mesh_fan import fan

#: Vertices, faces, UVs and normals.
Arrays = tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]


def parse_obj(data: bytes) -> Arrays:
    """Vertices float64 (V, 3), faces int64 (F, 3), UVs float64 (F, 3, 2) or None, normals float64 (F, 3, 3) or None.

    Polygons are cut into fans, indices may count from the end, groups and materials are ignored. A corner
    without a UV gets (0, 0) where others have one, and likewise without a normal; where normals are no numbers there are none.

    Raises:
        BadInput: a sentence without the file's name. Numbers may still be out of range or not finite.
    """
    data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\t", b" ")
    lines = [line.lstrip() for line in data.splitlines()]
    vertices = numbers([line for line in lines if line.startswith(b"v ")], 3, "vertices")
    texture = numbers([line for line in lines if line.startswith(b"vt ")], 2, "UVs")
    polygons = [line for line in lines if line.startswith(b"f ")]
    if not polygons:
        return vertices, np.empty((0, 3), np.int64), None, None
    sizes, corners = _corners(polygons)
    if (corners < 0).any():
        _count_from_start(lines, sizes, corners)
    if len(vertices) < corners[:, 0].max() or corners[:, 0].min() < 1:
        raise BadInput("a face names a vertex that is not there; export the mesh again.")
    if len(texture) < corners[:, 1].max() or corners[:, 1].min() < 0:
        raise BadInput("a face names a UV that is not there; export the mesh again.")
    triangles = fan(sizes)
    faces = corners[:, 0][triangles] - 1
    normals = _normals(lines)
    normal_index = np.where((corners[:, 2] > 0) & (corners[:, 2] <= len(normals)), corners[:, 2], 0)
    return (
        vertices,
        faces,
        _at_corners(texture, corners[:, 1][triangles]),
        _at_corners(normals, normal_index[triangles]),
    )


def _normals(lines: list[bytes]) -> np.ndarray:
    """(N, 3), none where a line is no 3 numbers: exporters write what they like for a face of no area."""
    try:
        return numbers([line for line in lines if line.startswith(b"vn ")], 3, "normals")
    except BadInput:
        return np.empty((0, 3))


def _at_corners(values: np.ndarray, index: np.ndarray) -> np.ndarray | None:
    """(F, 3, width) values at corners by `index` (F, 3), 1 for the first of `values` (N, width); zeros where it is 0. None
    if it is 0 everywhere."""
    return np.vstack([np.zeros((1, values.shape[1])), values])[index] if index.any() else None


def numbers(lines: list[bytes], columns: int, what: str) -> np.ndarray:
    """The first `columns` numbers behind each line's keyword, float64 (N, columns). Lines may hold more
    (weights, colours); a vt line of one number has v = 0."""
    if not lines:
        return np.empty((0, columns))
    rows = [b" ".join(line.split(None, columns + 1)[1 : columns + 1]) for line in lines]
    if columns == 2:
        rows = [row if b" " in row else row + b" 0" for row in rows]
    message = f"some {what} are not {columns} numbers"
    values = scan(b" ".join(rows), np.float64, message)
    if len(values) != columns * len(rows):
        raise BadInput(f"{message}; export the mesh again.")
    return values.reshape(-1, columns)


def scan(text: bytes, kind: type, what: str) -> np.ndarray:
    """The numbers of a text, separated by white space. Raises BadInput for any other word."""
    if not text.strip():
        return np.empty(0, kind)
    try:
        return np.fromstring(text, kind, sep=" ")
    except ValueError as error:
        raise BadInput(f"{what}; export the mesh again.") from error


def _corners(polygons: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
    """Corners per polygon (P,), and per corner its vertex, UV and normal as written, 0 for none, int64 (C, 3)."""
    if any(b"#" in line for line in polygons):
        polygons = [line.partition(b"#")[0] for line in polygons]
    sizes = np.array([len(line.split()) - 1 for line in polygons], np.int64)
    if sizes.min() < 3:
        raise BadInput("a face has fewer than 3 corners; export the mesh again.")
    corners = b" ".join([line[2:] for line in polygons]).split()  # lists of lists would wake the collector
    slashes = {word.count(b"/") for word in corners}
    if len(slashes) > 1 or max(slashes) > 2:
        corners = [b"/".join([*word.split(b"/"), b"0", b"0"][:3]) for word in corners]
        slashes = {2}
    columns = slashes.pop() + 1
    text = b" ".join(corners) + b" "
    if columns > 1:
        text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/", b" ")
    message = "a face has corners that are not whole numbers"
    values = scan(text, np.int64, message)
    if len(values) != columns * len(corners):
        raise BadInput(f"{message}; export the mesh again.")
    values = values.reshape(-1, columns)
    return sizes, np.pad(values, [(0, 0), (0, 3 - columns)])


def _count_from_start(lines: list[bytes], sizes: np.ndarray, corners: np.ndarray) -> None:
    """Replace, in place, indices that count back from their own line by those that count from the start."""
    kinds = np.array([line[:3] for line in lines])
    is_face = np.char.startswith(kinds, b"f ")
    for column, keyword in enumerate((b"v ", b"vt ", b"vn ")):
        count = np.repeat(np.cumsum(np.char.startswith(kinds, keyword))[is_face], sizes)
        negative = corners[:, column] < 0
        corners[negative, column] += count[negative] + 1
        corners[negative & (corners[:, column] <= 0), column] = -1  # before the first line
