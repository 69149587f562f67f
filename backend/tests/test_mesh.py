"""OBJ files, and what holds for meshes of any kind."""

from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.scene.mesh import Mesh, read_mesh, unique_rows, write_obj
from dante_w.scene.mesh_fan import fan
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from mesh_files import (
    CORNERS,
    FANS,
    LIST,
    SQUARE,
    XYZ,
    glb,
    ply,
    read,
    refused,
    same,
    square_glb,
    square_uvs,
    v_lines,
)

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=120
)


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
