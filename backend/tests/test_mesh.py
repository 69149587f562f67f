import json
import struct
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.scene.mesh import Mesh, read_mesh, unique_rows, write_obj
from dante_w.scene.mesh_fan import fan
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=120
)
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


# Polygons


@given(st.lists(st.integers(0, 7), max_size=6))
def test_fans_cover_each_polygon_from_its_first_corner(sizes):
    expected, start = [], 0
    for size in sizes:
        expected += [[start, start + i, start + i + 1] for i in range(1, size - 1)]
        start += size
    assert fan(np.array(sizes, np.int64)).tolist() == expected


# OBJ


def test_obj_with_polygons_uvs_normals_groups_and_comments(tmp_path):
    content = (
        "# made by hand\nmtllib a.mtl\no square\n" + v_lines(SQUARE) + v_lines(CORNERS, "vt") + "vn 0 0 1\n"
        "g one\nusemtl x\ns off\nf 1/1/1 2/2/1 3/3/1 4/4/1\n"
        "g two\n  f 3/3/1 2/2/1 1/1/1 # behind\n"
    )
    faces, uvs = [*FANS, [2, 1, 0]], np.array(CORNERS)[[*FANS, [2, 1, 0]]]
    for line_end in ("\n", "\r\n", "\r"):
        mesh = read(tmp_path, "a.obj", content.replace("\n", line_end))
        same(mesh, SQUARE, faces, uvs)
        assert mesh.normals.dtype == np.float32
        np.testing.assert_array_equal(mesh.normals, np.full((3, 3, 3), (0.0, 0.0, 1.0)))


@pytest.mark.parametrize("face", ["f 1 2 3 4", "f 1//9 2//9 3//9 4//9", "f\t1\t2   3 4", "f 1/ 2/ 3/ 4/"])
def test_obj_without_uvs(tmp_path, face):
    same(read(tmp_path, "a.OBJ", v_lines(SQUARE) + v_lines(CORNERS, "vt") + face), SQUARE, FANS, None)


def test_obj_of_faces_with_and_without_uvs_fills_in_zeros(tmp_path):
    content = (
        v_lines(SQUARE) + v_lines(CORNERS, "vt") + "f 1/2 2/3 3/4\nf 1//1 3//1 4//1\nf 2/2/1 3/3/1 4/4/1\n"
    )
    uvs = [[CORNERS[1], CORNERS[2], CORNERS[3]], np.zeros((3, 2)), [CORNERS[1], CORNERS[2], CORNERS[3]]]
    same(read(tmp_path, "a.obj", content), SQUARE, [[0, 1, 2], [0, 2, 3], [1, 2, 3]], uvs)


def test_obj_indices_from_the_end_count_from_their_own_line(tmp_path):
    content = (
        v_lines(SQUARE[:3]) + v_lines(CORNERS[:3], "vt") + "f -3/-3 -2/-2 -1/-1\n"
        "v 0 1 0\nvt 0 1\nf 1/1 -2/-2 -1/-1\n"
    )
    same(read(tmp_path, "a.obj", content), SQUARE, FANS, square_uvs())


def test_obj_skips_colours_weights_and_third_texture_coordinates(tmp_path):
    content = "v 0 0 0 1 0 0\nv 1 0 0 1\nv 1 1 0\nvt 0.5\nvt 1 2 3\nvt 1e-3 -4\nf 1/1 2/2 3/3\n"
    same(read(tmp_path, "a.obj", content), SQUARE[:3], [[0, 1, 2]], [[[0.5, 0], [1, 2], [0.001, -4]]])


def test_obj_lines_may_go_on(tmp_path):
    same(read(tmp_path, "a.obj", v_lines(SQUARE) + "f 1 2 \\\n3 4\n"), SQUARE, FANS, None)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no faces"),
        (v_lines(SQUARE), "no faces"),
        ("f 1 2 3\n", "vertex that is not there"),
        (v_lines(SQUARE) + "f 1 2 5\n", "vertex that is not there"),
        (v_lines(SQUARE) + "f 0 1 2\n", "vertex that is not there"),
        (v_lines(SQUARE) + "f -5 1 2\n", "vertex that is not there"),
        (v_lines(SQUARE) + "f 1 2 99999999999999999999999\n", "face"),
        (v_lines(SQUARE) + "f 1/1 2/1 3/1\n", "UV that is not there"),
        (v_lines(SQUARE) + "vt 0 0\nf 1/-2 2/1 3/1\n", "UV that is not there"),
        (v_lines(SQUARE) + "f 1 2\n", "fewer than 3"),
        (v_lines(SQUARE) + "f 1.5 2 3\n", "whole numbers"),
        (v_lines(SQUARE) + "f a b c\n", "whole numbers"),
        (v_lines(SQUARE) + "f /1 /2 /3\n", "whole numbers"),
        ("v 1 2\nf 1 1 1\n", "vertices are not 3 numbers"),
        ("v 1-2 3 4\nf 1 1 1\n", "vertices are not 3 numbers"),
        ("v 1 2 x\nf 1 1 1\n", "vertices are not 3 numbers"),
        ("v 1 2 3\nv 1 nan 3\nf 1 1 1\n", "vertex 1 is not finite"),
        ("v 1 2 1e999\nf 1 1 1\n", "vertex 0 is not finite"),
        ("v 1 2 3\nvt nan 0\nf 1 1 1\nf 1/1 1/1 1/1\n", "face 1 has a UV"),
    ],
)
def test_malformed_obj(tmp_path, content, words):
    assert words in refused(tmp_path, "a.obj", content)


numbers = st.floats(-1e300, 1e300)


@st.composite
def meshes(draw):
    count = draw(st.integers(1, 8))
    vertices = draw(arrays.arrays(np.float64, (count, 3), elements=numbers))
    shape = (draw(st.integers(1, 6)), 3)
    faces = draw(arrays.arrays(np.int32, shape, elements=st.integers(0, count - 1)))
    uvs = draw(
        st.none()
        | arrays.arrays(np.float64, (*shape, 2), elements=st.sampled_from([0.1, -0.0, 0.0, 1e-9, 7.5]))
    )
    unit = st.sampled_from([-0.0, 0.6, np.float32(1 / 3)])
    normals = draw(st.none() | arrays.arrays(np.float32, (*shape, 3), elements=unit))
    # a corner names a normal at least where a mesh has some
    return Mesh(vertices, faces, uvs, normals)


@in_one_folder
@given(meshes())
def test_obj_reads_back_bit_for_bit(tmp_path, mesh):
    write_obj(tmp_path / "a.obj", mesh)
    back = read_mesh(tmp_path / "a.obj")
    same(back, mesh.vertices, mesh.faces, mesh.uvs)
    assert back.vertices.tobytes() == mesh.vertices.tobytes()
    assert mesh.uvs is None or back.uvs.tobytes() == mesh.uvs.tobytes()
    assert (back.normals is None) == (mesh.normals is None)
    assert mesh.normals is None or back.normals.tobytes() == mesh.normals.tobytes()


def test_obj_is_compact(tmp_path):
    vertices = np.add(SQUARE, (4e6 + 1 / 3, 0.25, 0.0))
    write_obj(tmp_path / "a.obj", Mesh(vertices, np.array(FANS, np.int32), square_uvs()))
    text = (tmp_path / "a.obj").read_text()
    assert text.startswith("v 4000000.3333333335 0.25 0.0\n")
    assert text.count("vt ") == 4 and "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n" in text


def test_obj_that_cannot_be_written(tmp_path):
    mesh = Mesh(np.array(SQUARE, float), np.array(FANS, np.int32), None)
    with pytest.raises(BadInput, match="folder"):
        write_obj(tmp_path / "none" / "a.obj", mesh)
    if Path("/dev/full").exists():
        (tmp_path / "full.obj").symlink_to("/dev/full")
        with pytest.raises(OutOfRoom):
            write_obj(tmp_path / "full.obj", mesh)


@given(
    arrays.arrays(
        np.float64, st.tuples(st.integers(1, 30), st.just(2)), elements=st.sampled_from([0.0, -0.0, 1.0, 2.5])
    )
)
def test_unique_rows_rebuild_their_rows(rows):
    table, index = unique_rows(rows)
    assert table[index].tobytes() == rows.tobytes()
    assert len({row.tobytes() for row in rows}) == len(table)
    assert index[0] == 0 and (np.diff(np.unique(index, return_index=True)[1]) > 0).all()


NORMALS = [(1, 0, 0), (0, 2, 0), (0, 0, 3)]


@pytest.mark.parametrize(
    "face, used",
    [("f 1//1 2//2 3//3", [0, 1, 2]), ("f 1/1/-1 2/2/-2 3/3/-3", [2, 1, 0]), ("f 1//2 2 3//9", [1])],
)
def test_obj_normals_belong_to_their_corners(tmp_path, face, used):
    mesh = read(tmp_path, "a.obj", v_lines(SQUARE) + v_lines(CORNERS, "vt") + v_lines(NORMALS, "vn") + face)
    wanted = [NORMALS[i] for i in used] + [(0, 0, 0)] * (3 - len(used))  # a corner may have none
    np.testing.assert_array_equal(mesh.normals, [wanted])


@pytest.mark.parametrize("line", ["", "vn 0 0 -1.#IND\n", "vn 0 0\n"])
def test_obj_normals_that_are_none_do_no_harm(tmp_path, line):
    assert read(tmp_path, "a.obj", v_lines(SQUARE) + line + "f 1//1 2//1 3//1").normals is None
    odd = read(tmp_path, "a.obj", v_lines(SQUARE) + "vn nan inf 1e300\nf 1//1 2//1 3//1").normals
    np.testing.assert_array_equal(odd[0, 0], np.float32([np.nan, np.inf, np.inf]))


# PLY

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


@pytest.mark.parametrize("form", ORDERS)
class TestPly:
    def test_quads_and_colours(self, tmp_path, form):
        vertices = [[*xyz, 255] for xyz in SQUARE]
        content = ply(form, [("vertex", [*XYZ, "uchar red"], vertices), ("face", LIST, [[[0, 1, 2, 3]]])])
        same(read(tmp_path, "a.ply", content), SQUARE, FANS, None)

    def test_mixed_polygons_and_other_elements(self, tmp_path, form):
        elements = [
            ("camera", ["double f", "list ushort short k"], [[1.5, [1, 2, 3]], [2.5, []]]),
            ("vertex", ["double x", "double y", "double z"], SQUARE),
            ("face", [*LIST, "uchar flag"], [[[0, 1, 2], 1], [[0, 1, 2, 3], 2], [[3, 1, 0], 3]]),
            ("edge", ["int vertex1", "int vertex2"], [[0, 1]]),
        ]
        expected = [[0, 1, 2], *FANS, [3, 1, 0]]
        same(read(tmp_path, "a.ply", ply(form, elements)), SQUARE, expected, None)

    @pytest.mark.parametrize("names", ["st", "uv", ("texture_u", "texture_v")])
    def test_uvs_of_vertices(self, tmp_path, form, names):
        properties = [*XYZ, f"float {names[0]}", f"float {names[1]}"]
        vertices = [[*xyz, *uv] for xyz, uv in zip(SQUARE, CORNERS, strict=True)]
        content = ply(form, [("vertex", properties, vertices), ("face", LIST, [[face] for face in FANS])])
        same(read(tmp_path, "a.ply", content), SQUARE, FANS, square_uvs())

    def test_normals_of_vertices(self, tmp_path, form):
        properties = [*XYZ, "float nx", "float ny", "double nz"]
        vertices = [[*xyz, i, 0.5, -1] for i, xyz in enumerate(SQUARE)]
        content = ply(form, [("vertex", properties, vertices), ("face", LIST, [[face] for face in FANS])])
        wanted = np.array([vertex[3:] for vertex in vertices])[np.array(FANS)]
        np.testing.assert_array_equal(read(tmp_path, "a.ply", content).normals, wanted)

    def test_uvs_of_faces(self, tmp_path, form):
        properties = ["list uchar uint vertex_index", "list uchar float texcoord"]
        rows = [[[0, 1, 2, 3], [*CORNERS[0], *CORNERS[1], *CORNERS[2], *CORNERS[3]]], [[3, 1, 0], []]]
        content = ply(form, [("vertex", XYZ, SQUARE), ("face", properties, rows)])
        uvs = [*square_uvs(), np.zeros((3, 2))]
        same(read(tmp_path, "a.ply", content), SQUARE, [*FANS, [3, 1, 0]], uvs)

    def test_a_wrong_number_of_texture_coordinates(self, tmp_path, form):
        properties = [*LIST, "list uchar float texcoord"]
        content = ply(form, [("vertex", XYZ, SQUARE), ("face", properties, [[[0, 1, 2], [0, 1, 2]]])])
        assert "two texture coordinates" in refused(tmp_path, "a.ply", content)

    def test_a_point_cloud(self, tmp_path, form):
        assert "no faces" in refused(tmp_path, "a.ply", ply(form, [("vertex", XYZ, SQUARE)]))
        assert "no faces" in refused(
            tmp_path, "a.ply", ply(form, [("vertex", XYZ, SQUARE), ("face", LIST, [])])
        )

    def test_indices_out_of_range(self, tmp_path, form):
        for bad in (4, -1):
            content = ply(form, [("vertex", XYZ, SQUARE), ("face", LIST, [[[0, 1, bad]]])])
            assert "not there" in refused(tmp_path, "a.ply", content)

    def test_a_vertex_that_is_not_finite(self, tmp_path, form):
        vertices = [*SQUARE[:3], [0, float("nan"), 0]]
        content = ply(form, [("vertex", XYZ, vertices), ("face", LIST, [[[0, 1, 2]]])])
        assert "vertex 3 is not finite" in refused(tmp_path, "a.ply", content)

    def test_cut_anywhere(self, tmp_path, form):
        content = ply(form, [("vertex", XYZ, SQUARE), ("face", LIST, [[face] for face in FANS])]).rstrip(
            b"\n"
        )
        for length in range(len(content)):
            refused(tmp_path, "a.ply", content[:length])

    def test_counts_that_the_file_does_not_hold(self, tmp_path, form):
        content = ply(form, [("vertex", XYZ, SQUARE), ("face", LIST, [[face] for face in FANS])])
        for old, new in (
            (b"vertex 4", b"vertex 9000000000000000"),
            (b"face 2", b"face -2"),
            (b"face 2", b"face x"),
        ):
            refused(tmp_path, "a.ply", content.replace(old, new))


# GLB


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


@pytest.mark.parametrize("index", ["<u1", "<u2", "<u4"])
@pytest.mark.parametrize("uv", ["<f4", "<u1", "<u2"])
def test_glb_of_every_type_of_index_and_uv(tmp_path, index, uv):
    same(read(tmp_path, "a.glb", glb(*square_glb(index, uv))), SQUARE, FANS, square_uvs())


def test_glb_nodes_move_turn_scale_and_repeat(tmp_path):
    document, binary = square_glb()
    half = 0.5**0.5  # a quarter turn about z, in two nodes
    document["nodes"] = [
        {"children": [1], "translation": [10, 0, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, 0, half, half]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
    ]
    document["scenes"] = [{}, {"nodes": [0, 2]}]
    document["scene"] = 1
    mesh = read(tmp_path, "a.glb", glb(document, binary))
    turned = np.array([[10 - 2 * y, 2 * x, 0] for x, y, _ in SQUARE])
    np.testing.assert_allclose(mesh.vertices[:4], turned, atol=1e-12)
    np.testing.assert_array_equal(mesh.vertices[4:], [[5 - x, 6 + y, 7] for x, y, _ in SQUARE])
    np.testing.assert_array_equal(mesh.faces[2:], np.array(FANS)[:, ::-1] + 4)  # mirrored: turned round
    np.testing.assert_array_equal(mesh.uvs[2:], square_uvs()[:, ::-1])


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_glb_normals_turn_with_their_node(tmp_path, flip):
    document, binary = square_glb(attributes={"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 0})
    document["nodes"][0]["scale"] = [2.0 * flip, 1.0, 1.0]
    mesh = read(tmp_path, "a.glb", glb(document, binary))
    own = np.array(SQUARE, float)[np.array(FANS)[:, :: int(flip)]]  # positions stand in for normals
    np.testing.assert_array_equal(mesh.normals, own * (flip, 2.0, 2.0))


def test_glb_without_scenes_indices_or_uvs(tmp_path):
    document, binary = square_glb(attributes={"POSITION": 0})
    del document["scenes"], document["meshes"][0]["primitives"][0]["indices"]
    document["accessors"][0]["count"] = 3
    same(read(tmp_path, "a.glb", glb(document, binary)), SQUARE[:3], [[0, 1, 2]], None)


def test_glb_lines_are_skipped_and_missing_uvs_filled(tmp_path):
    document, binary = square_glb()
    first = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"] = [
        {**first, "mode": 1},
        first,
        {**first, "attributes": {"POSITION": 0}},
    ]
    mesh = read(tmp_path, "a.glb", glb(document, binary))
    same(mesh, SQUARE * 2, [*FANS, *(np.array(FANS) + 4)], [*square_uvs(), *np.zeros((2, 3, 2))])


def changed(document: dict, path: tuple, value: object) -> dict:
    document = json.loads(json.dumps(document))
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("meshes", 0, "primitives", 0, "extensions"), {"KHR_draco_mesh_compression": {}}, "compress"),
        (("extensionsRequired",), ["EXT_meshopt_compression"], "compress"),
        (("accessors", 0, "sparse"), {}, "sparse"),
        (("meshes", 0, "primitives", 0, "mode"), 5, "strips"),
        (("buffers", 0, "uri"), "a.bin", "another file"),
        (("bufferViews", 0, "buffer"), 1, "another file"),
        (("meshes", 0, "primitives"), [], "no faces"),
        (("nodes", 0, "children"), [0], "well-formed"),
        (("nodes", 0, "mesh"), 7, "well-formed"),
        (("scenes", 0, "nodes"), [7], "well-formed"),
        (("scenes", 0, "nodes"), 3, "well-formed"),
        (("accessors", 0, "count"), 10**9, "well-formed"),
        (("accessors", 0, "count"), -1, "well-formed"),
        (("accessors", 0, "componentType"), 1, "well-formed"),
        (("accessors", 0, "type"), "VEC2", "well-formed"),
        (("accessors", 0, "byteOffset"), 10**9, "well-formed"),
        (("accessors", 0, "byteOffset"), -4, "well-formed"),
        (("bufferViews", 0, "byteStride"), -20, "well-formed"),
        (("accessors", 2, "count"), 5, "well-formed"),
        (("accessors", 0, "count"), 2, "not there"),
        (("nodes", 0, "scale"), [float("nan")] * 3, "not finite"),
        (("nodes",), None, "well-formed"),
    ],
)
def test_malformed_glb(tmp_path, path, value, words):
    document, binary = square_glb()
    assert words in refused(tmp_path, "a.glb", glb(changed(document, path, value), binary))


def test_glb_of_no_version_or_json(tmp_path):
    whole = glb(*square_glb())
    for content in (
        b"",
        b"glTF",
        whole[:20],
        whole[:-30],
        b"GLTF" + whole[4:],
        glb({}),
        whole.replace(b"{", b"[", 1),
    ):
        refused(tmp_path, "a.glb", content)
    assert "version 2" in refused(tmp_path, "a.glb", whole[:4] + b"\1" + whole[5:])


# Any


def test_other_and_missing_files(tmp_path):
    assert "export the mesh as .obj" in refused(tmp_path, "a.fbx", b"")
    with pytest.raises(BadInput, match="no such mesh"):
        read_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(BadInput, match="cannot be read"):
        read_mesh(tmp_path / "folder.obj")


@in_one_folder
@given(st.sampled_from(["obj", "ply", "glb"]), st.binary(max_size=100))
def test_random_bytes_are_refused(tmp_path, ending, content):
    start = {"obj": b"v 0 0 0\nf ", "ply": b"ply\nformat ascii 1.0\n", "glb": b"glTF\2\0\0\0\0\0\0\0"}[ending]
    for whole in (content, start + content):
        try:
            read(tmp_path, f"a.{ending}", whole)
        except BadInput as error:
            assert f"a.{ending}" in str(error)


SEEDS = {
    "obj": (v_lines(SQUARE) + v_lines(CORNERS, "vt") + "f 1/1 2/2 3/3 4/4\nf -1/-1 -2/-2 -3/-3\n").encode(),
    "ascii.ply": ply("ascii", [("vertex", XYZ, SQUARE), ("face", LIST, [[[0, 1, 2, 3]], [[0, 1, 2]]])]),
    "little.ply": ply(
        "binary_little_endian", [("vertex", XYZ, SQUARE), ("face", LIST, [[[0, 1, 2, 3]], [[0, 1, 2]]])]
    ),
    "x.glb": glb(*square_glb()),
}


@in_one_folder
@given(
    st.sampled_from(sorted(SEEDS)),
    st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.binary(max_size=3), st.integers(0, 3)),
        min_size=1,
        max_size=3,
    ),
)
def test_damaged_files_read_or_are_refused(tmp_path, name, changes):
    content = SEEDS[name]
    for where, new, removed in changes:
        place = int(where * len(content))
        content = content[:place] + new + content[place + removed :]
    try:
        mesh = read(tmp_path, f"a.{name}", content)
    except BadInput:
        return
    assert (
        np.isfinite(mesh.vertices).all() and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    )
    assert mesh.uvs is None or (mesh.uvs.shape == (*mesh.faces.shape, 2) and np.isfinite(mesh.uvs).all())
