"""Structured nonsense for the readers: 250 inputs each here, 20,000 in `python3 dev.py bench stability --only faults`.

A reader returns something valid or raises `BadInput`; damage of single bytes is tried beside each reader's own tests.
"""

from __future__ import annotations

import copy
import re
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Camera
from dante_w.scene.cameras import check_camera, directions, project
from dante_w.scene.colmap import read_colmap
from dante_w.scene.mesh import read_mesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_mesh import CORNERS, SQUARE, glb, ply, square_glb, v_lines

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
nonsense = settings(suppress_health_check=list(HealthCheck), deadline=None, max_examples=250)
numbers = st.sampled_from(
    [
        "0",
        "-1",
        "255",
        "65536",
        "2147483648",
        "-2147483649",
        "4294967295",
        "9223372036854775808",
        "1e308",
        "1e400",
        "1e-320",
        "nan",
        "-inf",
        "0x1",
        "1_0",
        ".",
        "٣",
    ]
)
values = st.sampled_from(
    [None, True, -1, 10**400, 2**31, 2**63, 1e308, float("nan"), "", "x", "../x", "\ud800", [], {}, [[]], 0.5]
)
places = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), numbers), min_size=1, max_size=3)
FACES = ["list uchar int vertex_indices", "list uchar float texcoord"]
MESHES = {
    "obj": (
        v_lines(SQUARE)
        + v_lines(CORNERS, "vt")
        + v_lines(SQUARE, "vn")
        + "f 1/1/1 2/2/2 3/3/4 4/4/3\nf -1/-1/-1 -2/-2/-2 -3/-3/-3\n"
    ).encode(),
    "ply": ply(
        "ascii",
        [
            (
                "vertex",
                ["float x", "float y", "float z", "float nx", "float ny", "float nz"],
                [[*xyz, 0, 0, 1] for xyz in SQUARE],
            ),
            ("face", FACES, [[[0, 1, 2], [0, 0, 1, 0, 1, 1]]]),
        ],
    ),
}
CAMERAS = "1 PINHOLE 8 6 9 9 4 3\n2 OPENCV 8 6 9 9 4 3 0.1 0 0 0\n3 FOV 8 6 9 9 4 3 0.5\n"
IMAGES = "1 1 0 0 0 0 0 0 1 a.png\n1.5 2.5 -1\n2 0.7 0.7 0 0 1 2 3 2 b c.png\n\n3 0 1 0 0 0 0 1 3 c.png\n\n"


def swapped(text: bytes, changes: list[tuple[float, str]]) -> bytes:
    """Other numbers in place of some of a text's."""
    for where, number in changes:
        found = list(re.finditer(rb"-?\d+\.?\d*", text))
        at = found[int(where * len(found))]
        text = text[: at.start()] + number.encode() + text[at.end() :]
    return text


def read_or_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    try:
        mesh = read_mesh(path)
    except BadInput as error:
        assert "\n" not in str(error)
        return
    assert np.isfinite(mesh.vertices).all() and 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    assert mesh.normals is None or mesh.normals.shape == (*mesh.faces.shape, 3)
    assert mesh.uvs is None or (mesh.uvs.shape == (*mesh.faces.shape, 2) and np.isfinite(mesh.uvs).all())


def look_through(camera: Camera) -> None:
    assert directions(camera, np.array([[0.5, 0.5], [1e9, -1e9]])).shape == (2, 3)
    assert project(camera, np.eye(4), np.array([[0.0, 0.0, -1.0]])).shape == (1, 2)


@pytest.mark.parametrize("ending", MESHES)
def test_other_numbers_in_a_mesh(tmp_path, ending):
    @nonsense
    @given(places)
    def check(changes):
        read_or_refused(tmp_path / f"a.{ending}", swapped(MESHES[ending], changes))

    check()


def leaves(tree: object, path: tuple = ()) -> list[tuple]:
    """The places of a JSON value, itself included."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(place for key, value in inner for place in leaves(value, (*path, key)))]


DOCUMENT, BINARY = square_glb()
PLACES = [place for place in leaves(DOCUMENT) if place]


@nonsense
@given(st.lists(st.tuples(st.sampled_from(PLACES), values), min_size=1, max_size=2))
def test_other_values_in_a_glb(tmp_path, changes):
    document = copy.deepcopy(DOCUMENT)
    for place, value in changes:
        try:
            inner = document
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # the first change took the second one's place away
    read_or_refused(tmp_path / "a.glb", glb(document, BINARY))


@pytest.mark.parametrize("part", ["cameras", "images"])
def test_other_numbers_in_a_colmap_model(tmp_path, part):
    (tmp_path / "images").mkdir()
    texts = {"cameras": CAMERAS.encode(), "images": IMAGES.encode()}

    @nonsense
    @given(places)
    def check(changes):
        for name, text in texts.items():
            (tmp_path / f"{name}.txt").write_bytes(swapped(text, changes) if name == part else text)
        try:
            frames = read_colmap(tmp_path).frames
        except BadInput:
            return
        for frame in frames:
            assert np.isfinite(frame.camera_to_world).all()
            look_through(frame.camera)

    check()


MODELS = "SIMPLE_PINHOLE PINHOLE SIMPLE_RADIAL RADIAL OPENCV OPENCV_FISHEYE FULL_OPENCV FOV THIN_PRISM_FISHEYE EQUIRECTANGULAR X"
usual = st.sampled_from([9.0, 9.0, 4.0, 0.01, 0.0])
unusual = st.sampled_from([-1.0, 1e-320, 1e308, float("nan"), float("inf"), 1e6, -1e9])


@nonsense
@given(
    st.sampled_from(MODELS.split()),
    st.sampled_from([8, 6, 0, -1, 2**20, 2**31, 2**63]),
    st.lists(usual | usual | usual | unusual, max_size=13),
)
def test_cameras_of_every_kind_can_be_looked_through_or_are_refused(model, side, params):
    camera = Camera(model, side, side, tuple(params))
    try:
        check_camera(camera)
    except BadInput:
        return
    look_through(camera)
