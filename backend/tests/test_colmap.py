import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Camera
from dante_w.scene.colmap import is_colmap, read_colmap
from dante_w.scene.images import write_png
from dante_w.scene.load import load_scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CAMERAS = {
    1: ("PINHOLE", 640, 480, (500.0, 510.0, 320.0, 240.0)),
    2: ("OPENCV", 320, 200, (300.0, 310.0, 160.0, 100.0, 0.1, -0.02, 0.003, 0.004)),
    5: (
        "RAD_TAN_THIN_PRISM_FISHEYE",
        64,
        48,
        (50.0, 51.0, 32.0, 24.0, *np.linspace(0.001, 0.012, 12).tolist()),
    ),
}
IMAGES = {7: ("b/two words.png", 1), 3: ("a.png", 5), 4: ("c.png", 2)}


def rotation(number: int) -> pycolmap.Rotation3d:
    quaternion = np.array([0.1 * number, -0.2, 0.3, 0.9])  # x, y, z, w
    return pycolmap.Rotation3d(quaternion / np.linalg.norm(quaternion))


def model() -> pycolmap.Reconstruction:
    made = pycolmap.Reconstruction()
    for number, (name, width, height, params) in CAMERAS.items():
        camera = pycolmap.Camera(
            model=name, width=width, height=height, params=list(params), camera_id=number
        )
        made.add_camera_with_trivial_rig(camera)
    for number, (name, camera) in IMAGES.items():
        image = pycolmap.Image(
            name=name,
            camera_id=camera,
            image_id=number,
            points2D=[pycolmap.Point2D([1.0, 2.0])] * (number - 3),
        )
        pose = pycolmap.Rigid3d(rotation(number), np.array([number, 2.0, 3.0]))
        made.add_image_with_trivial_frame(image, pose)
    return made


def write(folder: Path, kind: str) -> Path:
    folder.mkdir(parents=True)
    (model().write_text if kind == "text" else model().write_binary)(str(folder))
    return folder


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """One model as text and as binary."""
    return {kind: write(tmp_path_factory.mktemp("model") / kind, kind) for kind in ("text", "binary")}


@pytest.mark.parametrize("kind", ["text", "binary"])
@pytest.mark.parametrize("place", [".", "sparse/0", "sparse", "colmap/sparse/0"])
def test_models_read_wherever_they_lie(tmp_path, written, kind, place):
    (tmp_path / "images").mkdir()
    (tmp_path / "mesh.ply").touch()
    assert not is_colmap(tmp_path)
    shutil.copytree(written[kind], tmp_path / place, dirs_exist_ok=True)
    assert is_colmap(tmp_path)
    scene = read_colmap(tmp_path)
    root = tmp_path.resolve()
    assert scene.mesh == root / "mesh.ply" and scene.source == (root / place).resolve()
    names = [frame.image.relative_to(root / "images").as_posix() for frame in scene.frames]
    assert names == ["a.png", "b/two words.png", "c.png"]
    for frame, number in zip(scene.frames, (3, 7, 4), strict=True):
        assert frame.camera == Camera(*CAMERAS[IMAGES[number][1]])
        assert frame.mask is None and frame.albedo is None
        camera_from_world = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(frame.camera_to_world)
        np.testing.assert_allclose(camera_from_world[:3, :3], rotation(number).matrix(), atol=1e-12)
        np.testing.assert_allclose(camera_from_world[:, 3], [number, 2.0, 3.0, 1.0], atol=1e-12)


def test_the_points_are_not_needed(tmp_path, written):
    (tmp_path / "images").mkdir()
    for part in ("cameras.bin", "images.bin"):
        shutil.copy(written["binary"] / part, tmp_path / part)
    assert len(read_colmap(tmp_path).frames) == 3


def test_photos_may_lie_elsewhere(tmp_path, written):
    (tmp_path / "photos").mkdir()
    scene = read_colmap(written["text"], tmp_path / "photos")
    assert scene.frames[0].image == tmp_path.resolve() / "photos" / "a.png"
    for photos in (None, tmp_path / "none"):
        with pytest.raises(BadInput, match="photos' folder is missing"):
            read_colmap(written["text"], photos)


def test_no_model_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no COLMAP model"):
        read_colmap(tmp_path)


def text_model(folder: Path, cameras: str = "1 PINHOLE 4 3 5 5 2 1.5", images: str = "") -> Path:
    (folder / "images").mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text("# cameras\n" + cameras)
    (folder / "images.txt").write_text("# images\n" + (images or "1 1 0 0 0 0 0 0 1 a.png\n\n"))
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "../a.png",
        "/etc/passwd",
        "b/../../a.png",
        "..\\a.png",
        "C:\\a.png",
        "C:a.png",
        "\\\\host\\a",
        "a\x07b",
    ],
)
def test_names_that_lead_out_are_refused(tmp_path, name):
    with pytest.raises(BadInput, match="leads out") as caught:
        read_colmap(text_model(tmp_path, images=f"1 1 0 0 0 0 0 0 1 {name}\n\n"))
    assert "\n" not in str(caught.value)


def test_a_pose_at_rest_looks_along_colmaps_z(tmp_path):
    (frame,) = read_colmap(text_model(tmp_path, images="1 2 0 0 0 1 2 3 1 a.png\n1 2 -1\n")).frames
    np.testing.assert_array_equal(frame.camera_to_world[:3, :3], np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(frame.camera_to_world[:3, 3], [-1.0, -2.0, -3.0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"images": "# none\n"}, "no photo is registered"),
        ({"images": "1 1 0 0 0 0 0 0 9 a.png\n"}, "the camera of a.png"),
        ({"images": "1 0 0 0 0 0 0 0 1 a.png\n"}, "the pose of a.png"),
        ({"images": "1 1 0 nan 0 0 0 0 1 a.png\n"}, "the pose of a.png"),
        ({"images": "1 1 0 0 0 0 inf 0 1 a.png\n"}, "the pose of a.png"),
        ({"images": "1 1 0 0 0 0 0 0 1\n"}, "damaged"),
        ({"images": "1 1 x 0 0 0 0 0 1 a.png\n"}, "damaged"),
        ({"cameras": "1 PINHOLE 4"}, "damaged"),
        ({"cameras": "1 PINHOLE 4 3 5 5 2"}, "3 parameters"),
        ({"cameras": "1 NO_SUCH 4 3 5 5 2 1"}, "NO_SUCH"),
        ({"cameras": "1 PINHOLE 0 3 5 5 2 1"}, "no size"),
        ({"cameras": "1 PINHOLE 4 3 nan 5 2 1"}, "not finite"),
        ({"cameras": "1 EQUIRECTANGULAR 4 3 4 3"}, "PINHOLE photos"),
    ],
)
def test_malformed_models_are_refused(tmp_path, changes, words):
    with pytest.raises(BadInput, match=words) as caught:
        read_colmap(text_model(tmp_path, **changes))
    assert str(tmp_path.resolve()) in str(caught.value)


@pytest.mark.parametrize("part", ["cameras", "images"])
def test_binary_models_cut_anywhere_are_refused(tmp_path, written, part):
    (tmp_path / "images").mkdir()
    for name in ("cameras.bin", "images.bin"):
        shutil.copy(written["binary"] / name, tmp_path / name)
    content = (tmp_path / f"{part}.bin").read_bytes()
    end = len(content) - (24 * 4 + 1 if part == "images" else 0)  # the last photo's points are skipped unread
    for length in range(0, end, 3):
        (tmp_path / f"{part}.bin").write_bytes(content[:length])
        with pytest.raises(BadInput, match="damaged"):
            read_colmap(tmp_path)
    (tmp_path / f"{part}.bin").write_bytes(struct.pack("<Q", 2**63) + content[8:])
    with pytest.raises(BadInput, match="damaged"):
        read_colmap(tmp_path)


@pytest.mark.parametrize("kind", ["text", "binary"])
def test_damaged_models_read_or_are_refused(tmp_path, written, kind):
    (tmp_path / "images").mkdir()
    ending = ".txt" if kind == "text" else ".bin"
    contents = {part: (written[kind] / (part + ending)).read_bytes() for part in ("cameras", "images")}

    @settings(suppress_health_check=list(HealthCheck), deadline=None, max_examples=80)
    @given(
        st.sampled_from(["cameras", "images"]),
        st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=2)), max_size=3),
    )
    def check(part, changes):
        for name, content in contents.items():
            if name == part:
                for where, new in changes:
                    place = int(where * len(content))
                    content = content[:place] + new + content[place + 1 :]
            (tmp_path / (name + ending)).write_bytes(content)
        try:
            scene = read_colmap(tmp_path)
        except BadInput:
            return
        for frame in scene.frames:
            assert np.isfinite(frame.camera_to_world).all() and np.isfinite(frame.camera.params).all()
            assert frame.image.is_relative_to(tmp_path.resolve() / "images")

    check()


def test_links_that_lead_out_are_refused_unless_the_user_names_their_place(tmp_path):
    parent, outside = tmp_path / "scene", tmp_path / "outside"
    parent.mkdir(), outside.mkdir()
    text_model(parent)
    (outside / "a.png").touch()
    (parent / "images" / "a.png").symlink_to(outside / "a.png")
    with pytest.raises(BadInput, match="leads out"):
        read_colmap(parent)
    (parent / "images" / "a.png").unlink()
    (parent / "images").rmdir()
    (parent / "images").symlink_to(outside)
    with pytest.raises(BadInput, match="--images"):
        read_colmap(parent)
    assert read_colmap(parent, outside).frames[0].image == (outside / "a.png").resolve()
    (parent / "images").unlink()
    (parent / "photos").mkdir()
    (parent / "images").symlink_to(parent / "photos")  # inside
    (parent / "photos" / "a.png").symlink_to(parent / "photos" / "a.png")
    with pytest.raises(BadInput, match=r"a\.png"):
        load_scene(parent)


def test_a_mesh_that_is_a_link_out_is_the_users_to_name(tmp_path):
    parent = tmp_path / "scene"
    parent.mkdir()
    text_model(parent)
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (parent / "mesh.obj").symlink_to(tmp_path / "mesh.obj")
    write_png(parent / "images" / "a.png", np.zeros((3, 4, 3), np.uint8))
    with pytest.raises(BadInput, match="--mesh"):
        load_scene(parent)
    assert len(load_scene(parent, parent / "mesh.obj")[1].faces) == 1


def test_a_camera_without_a_focal_length_is_refused(tmp_path):
    for focal in ("0 5", "5 -1"):
        with pytest.raises(BadInput, match="focal"):
            read_colmap(text_model(tmp_path, f"1 PINHOLE 4 3 {focal} 2 1.5"))
