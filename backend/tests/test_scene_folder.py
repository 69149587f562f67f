import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract import scene_folder
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import INTRINSIC_KEYS, Camera, Frame, Scene, read_scene, write_scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

in_one_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60
)
IDENTITY = np.eye(4).tolist()
PLAIN = {"w": 8, "h": 6, "fl_x": 5.0, "fl_y": 5.0, "cx": 4.0, "cy": 3.0}


def put(folder: Path, content: object) -> Path:
    text = content if isinstance(content, str) else json.dumps(content)
    (folder / "transforms.json").write_text(text, encoding="utf-8")
    return folder


def frame(**changes: object) -> dict[str, object]:
    return {"file_path": "a.png", "transform_matrix": IDENTITY, **PLAIN, **changes}


def refused(folder: Path, content: object) -> str:
    """The one sentence with which the scene is refused."""
    put(folder, content)
    with pytest.raises(BadInput) as caught:
        read_scene(folder)
    message = str(caught.value)
    assert str(folder.resolve()) in message and "\n" not in message and message.endswith(".")
    return message


finite = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e6)
names = st.text(st.characters(codec="utf-8", exclude_characters="/\\\0"), min_size=1, max_size=20).filter(
    lambda name: name not in (".", "..")
)


@st.composite
def poses(draw):
    quaternion = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(4)])
    length = np.linalg.norm(quaternion)
    w, x, y, z = quaternion / length if length > 0.1 else (1.0, 0.0, 0.0, 0.0)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = [draw(finite) for _ in range(3)]
    return pose


@st.composite
def cameras(draw):
    model = draw(st.sampled_from([*INTRINSIC_KEYS, "SIMPLE_RADIAL", "THIN_PRISM_FISHEYE"]))
    count = len(INTRINSIC_KEYS.get(model, ["f", "x", "y", "k"]))
    focal = [draw(positive), draw(positive)]
    rest = [draw(st.floats(0.001, 0.5)) for _ in range(count - 2)]  # none is 0: the model stays needed
    sides = st.integers(1, 20000)
    return Camera(model, draw(sides), draw(sides), tuple(focal + rest))


@st.composite
def frames(draw):
    return draw(names), draw(cameras()), draw(poses()), draw(st.booleans()), draw(st.booleans())


@in_one_folder
@given(st.lists(frames(), min_size=1, max_size=4), st.booleans())
def test_what_is_written_reads_back(tmp_path, parts, with_mesh):
    root = tmp_path.resolve()
    scene = Scene(
        root / "transforms.json",
        root / "mesh.ply" if with_mesh else None,
        [
            Frame(
                root / "images" / (name + ".png"),
                camera,
                pose,
                root / "masks" / (name + ".png") if mask else None,
                root / "priors" / (name + ".png") if prior else None,
            )
            for name, camera, pose, mask, prior in parts
        ],
    )
    assert write_scene(tmp_path, scene) == scene.source
    back = read_scene(tmp_path)
    assert (back.source, back.mesh) == (scene.source, scene.mesh)
    for one, other in zip(back.frames, scene.frames, strict=True):
        assert (one.image, one.mask, one.albedo) == (other.image, other.mask, other.albedo)
        assert one.camera == other.camera
        np.testing.assert_allclose(one.camera_to_world, other.camera_to_world, rtol=1e-12, atol=1e-12)


def test_undistorted_cameras_read_as_pinhole(tmp_path):
    camera = Camera("OPENCV", 8, 6, (5.0, 5.0, 4.0, 3.0, 0.0, 0.0, 0.0, 0.0))
    path = write_scene(tmp_path, Scene(tmp_path, None, [Frame(tmp_path / "a.png", camera, np.eye(4))]))
    assert read_scene(path).frames[0].camera == Camera("PINHOLE", 8, 6, (5.0, 5.0, 4.0, 3.0))


def test_writing_refuses_files_elsewhere_and_numbers_that_are_not_finite(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    camera = Camera("PINHOLE", 8, 6, (5.0, 5.0, 4.0, 3.0))
    with pytest.raises(ValueError):
        write_scene(folder, Scene(folder, None, [Frame(tmp_path / "a.png", camera, np.eye(4))]))
    with pytest.raises(ValueError):
        write_scene(folder, Scene(folder, None, [Frame(folder / "a.png", camera, np.full((4, 4), np.nan))]))
    assert not (folder / "transforms.json").exists()


def test_intrinsics_of_the_frame_win_over_those_above(tmp_path):
    scene = put(
        tmp_path, {**PLAIN, "frames": [{"file_path": "a.png", "transform_matrix": IDENTITY, "cx": 1}]}
    )
    assert read_scene(scene).frames[0].camera == Camera("PINHOLE", 8, 6, (5.0, 5.0, 1.0, 3.0))


def test_a_field_of_view_gives_the_focal_length(tmp_path):
    entry = {
        "file_path": "a",
        "transform_matrix": IDENTITY,
        "w": 800,
        "h": 400,
        "camera_angle_x": math.pi / 2,
    }
    got = read_scene(put(tmp_path, {"frames": [entry]})).frames[0]
    assert got.camera == Camera("PINHOLE", 800, 400, (pytest.approx(400), pytest.approx(400), 400, 200))
    assert got.image == tmp_path.resolve() / "a.png"
    got = read_scene(put(tmp_path, {"frames": [{**entry, "camera_angle_y": math.pi / 2}]})).frames[0]
    assert got.camera.params[1] == pytest.approx(200)


def test_poses_lose_a_uniform_scale_and_may_leave_out_the_last_row(tmp_path):
    pose = np.diag([2.0, 2.0, 2.0, 1.0])
    pose[:3, 3] = (1.0, 2.0, 3.0)
    got = read_scene(put(tmp_path, {"frames": [frame(transform_matrix=pose[:3].tolist())]}))
    np.testing.assert_allclose(got.frames[0].camera_to_world[:3, :3], np.eye(3))
    assert got.frames[0].camera_to_world[:, 3].tolist() == [1.0, 2.0, 3.0, 1.0]


def test_a_mesh_is_found_and_a_byte_order_mark_is_skipped(tmp_path):
    (tmp_path / "mesh.glb").touch()
    (tmp_path / "transforms_train.json").write_bytes(
        b"\xef\xbb\xbf" + json.dumps({"frames": [frame()]}).encode()
    )
    assert read_scene(tmp_path).mesh == tmp_path.resolve() / "mesh.glb"


@pytest.mark.parametrize(
    "name", ["/etc/passwd", "../a.png", "images/../../a.png", "..", ".", "a\0.png", "x" * 5000 + "/../.."]
)
@pytest.mark.parametrize("key", ["file_path", "mask_path", "albedo_path", "mesh_path"])
def test_paths_that_leave_the_folder_are_refused(tmp_path, key, name):
    content = (
        {"frames": [frame()], "mesh_path": name} if key == "mesh_path" else {"frames": [frame(**{key: name})]}
    )
    refused(tmp_path, content)


def test_symbolic_links_are_followed_and_judged(tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    (tmp_path / "secret.png").touch()
    (scene / "out.png").symlink_to(tmp_path / "secret.png")
    assert "outside" in refused(scene, {"frames": [frame(file_path="out.png")]})
    (scene / "in.png").symlink_to(scene / "real.png")
    got = read_scene(put(scene, {"frames": [frame(file_path="in.png")]}))
    assert got.frames[0].image == scene.resolve() / "real.png"


def test_a_loop_of_links_is_refused(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    put(tmp_path, {"frames": [frame(file_path="loop/a.png")]})
    if sys.version_info < (3, 13):  # later ones resolve a loop to itself
        refused(tmp_path, {"frames": [frame(file_path="loop/a.png")]})
    with pytest.raises(BadInput):
        read_scene(tmp_path / "loop")


def test_names_of_any_length_and_with_line_ends_stay_one_sentence(tmp_path):
    assert "\\n" in refused(tmp_path, {"frames": [frame(file_path="../a\nb")]})
    long = "x" * 5000  # without an ending, so it is looked for on disk
    assert read_scene(put(tmp_path, {"frames": [frame(file_path=long)]})).frames[0].image.suffix == ".png"
    with pytest.raises(BadInput):
        read_scene(tmp_path / long)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "3",
        '"frames"',
        "{}",
        '{"frames": null}',
        '{"frames": {}}',
        '{"frames": []}',
        '{"frames": [3]}',
        '{"frames": [[]]}',
        '{"frames": [null]}',
        "[" * 100_000,
        '{"frames": [' + '{"a":' * 100_000,
        '{"frames": [{"w": ' + "9" * 5000 + "}]}",
        '{"frames": [{"w": 1}',
    ],
)
def test_other_json_is_refused(tmp_path, text):
    refused(tmp_path, text)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "transforms.json").write_bytes(b'{"frames": "\xff\xfe"}')
    with pytest.raises(BadInput):
        read_scene(tmp_path)
    with pytest.raises(BadInput):
        read_scene(tmp_path / "missing")


HUGE = 10**400
WRONG = [None, "x", [], {}, [1], math.nan, math.inf, -math.inf, HUGE, -1, 0]


@pytest.mark.parametrize("value", WRONG, ids=lambda value: repr(value)[:12])
@pytest.mark.parametrize("key", ["w", "h", "fl_x", "fl_y", "camera_angle_x"])
def test_intrinsics_that_are_no_positive_number_are_refused(tmp_path, key, value):
    entry = frame(**{key: value})
    if key == "camera_angle_x":
        del entry["fl_x"]
    refused(tmp_path, {"frames": [entry]})


@pytest.mark.parametrize("value", WRONG[:9], ids=lambda value: repr(value)[:12])
@pytest.mark.parametrize("key", ["cx", "cy", "k1", "p2", "k6"])
def test_other_intrinsics_must_be_finite_numbers(tmp_path, key, value):
    assert key in refused(tmp_path, {"frames": [frame(**{key: value})]})


@pytest.mark.parametrize("value", [1e9, 1e308, 0.5])
def test_absurd_sizes_are_refused(tmp_path, value):
    assert "size" in refused(tmp_path, {"frames": [frame(w=value)]})


@pytest.mark.parametrize("key", ["w", "fl_x"])
def test_missing_intrinsics_are_named(tmp_path, key):
    entry = frame()
    del entry[key]
    assert key in refused(tmp_path, {"frames": [entry]})


@pytest.mark.parametrize(
    "changes",
    [
        {"camera_model": "FOV"},
        {"camera_model": [1]},
        {"params": 3},
        {"params": []},
        {"params": [1, None]},
        {"params": [HUGE]},
        {"camera_model": "FOV", "params": [-1, 1, 1, 1, 1]},
        {"camera_model": "PINHOLE", "params": [1, 1, 1]},
    ],
)
def test_camera_models_need_their_parameters(tmp_path, changes):
    refused(tmp_path, {"frames": [frame(**changes)]})


def matrix(row: int, column: int, value: object) -> list:
    rows = np.eye(4).tolist()
    rows[row][column] = value
    return rows


@pytest.mark.parametrize(
    "pose",
    [
        None,
        "x",
        3,
        [],
        [[1]],
        [[1, 2], [3]],
        np.eye(3).tolist(),
        np.zeros((4, 4)).tolist(),
        matrix(0, 0, math.nan),
        matrix(1, 3, math.inf),
        matrix(0, 0, HUGE),
        matrix(0, 0, "x"),
        matrix(0, 0, None),
        matrix(0, 0, 1e300),
        matrix(0, 0, 2.0),
        matrix(0, 0, -1.0),
        matrix(3, 3, 2.0),
        matrix(0, 1, 0.1),
        (np.eye(4) * 1e300).tolist(),
    ],
    ids=range(19),
)
def test_poses_that_are_not_rigid_are_refused(tmp_path, pose):
    assert "frame 0" in refused(tmp_path, {"frames": [frame(transform_matrix=pose)]})


@pytest.mark.parametrize("value", [None, 3, [], {}, "", [1]], ids=repr)
def test_a_photo_needs_a_name(tmp_path, value):
    refused(tmp_path, {"frames": [frame(file_path=value)]})


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
KEYS = [*frame(), "camera_model", "params", "mask_path", "camera_angle_x", "k1"]


@in_one_folder
@given(st.dictionaries(st.sampled_from(KEYS), anything, max_size=5), anything, st.text(max_size=3))
def test_only_bad_input_escapes(tmp_path, changes, mesh, tail):
    put(tmp_path, json.dumps({"frames": [frame(**changes)], "mesh_path": mesh}) + tail)
    try:
        scene = read_scene(tmp_path)
    except BadInput:
        return
    assert np.isfinite(scene.frames[0].camera_to_world).all()
    assert np.isfinite(scene.frames[0].camera.params).all() and scene.frames[0].camera.width > 0
    assert scene.frames[0].image.is_relative_to(tmp_path.resolve())


def test_the_contract_loads_without_the_package(tmp_path):
    """As a package of another name, which is how the add-on has it."""
    put(tmp_path, {"frames": []})
    folder = Path(scene_folder.__file__).parent
    names = sorted(path.stem for path in folder.glob("[a-z]*.py"))
    script = (
        "import importlib, sys, types\n"
        "sys.modules['dante_w'] = None  # as if it were not installed\n"
        "alone = sys.modules['alone'] = types.ModuleType('alone')\n"
        f"alone.__path__ = [{os.fspath(folder)!r}]\n"
        f"for name in {names!r}: importlib.import_module('alone.' + name)\n"
        "assert 'torch' not in sys.modules\n"
        f"try: sys.modules['alone.scene_folder'].read_scene({os.fspath(tmp_path)!r})\n"
        "except sys.modules['alone.errors'].BadInput as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-I", "-c", script], capture_output=True, text=True, check=True)
    assert "holds no frames" in done.stdout
