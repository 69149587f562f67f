"""GLB files."""

import json

import numpy as np
import pytest
from mesh_files import FANS, SQUARE, glb, read, refused, same, square_glb, square_uvs


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
