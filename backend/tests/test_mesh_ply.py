"""PLY files, ASCII and binary."""

import numpy as np
import pytest
from mesh_files import CORNERS, FANS, LIST, ORDERS, SQUARE, XYZ, ply, read, refused, same, square_uvs


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
