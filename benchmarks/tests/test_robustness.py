"""The spoilt scenes are spoilt as they say, and the table has a cell for each texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.scene_folder import Scene, read_scene, write_scene
from dante_w.rays.raycast import Frame3D
from dante_w.scene.images import read_photo
from dante_w.scene.mesh import read_mesh, write_obj
from measure.metrics import linear_from_srgb
from measure.spoils import CLIPPED, COVERED, SPOILS, spoilt
from measure.synthetic_scene import bumpy_sphere, write_photos
from robustness import VARIANTS, Row, table

PHOTOS = 12


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A scene in the layout of make_gigalit, with masks in place of alpha."""
    folder = tmp_path_factory.mktemp("sphere")
    mesh = bumpy_sphere(24)
    write_obj(folder / "mesh.obj", mesh)
    frames = write_photos(folder, mesh, 64, PHOTOS)
    written = write_scene(folder, Scene(folder / "transforms.json", None, frames))
    written.rename(folder / "transforms_train.json")
    return folder


@pytest.fixture(scope="module")
def copies(scene, tmp_path_factory) -> dict[str, Scene]:
    out = tmp_path_factory.mktemp("spoilt")
    return {spoil: read_scene(spoilt(scene, spoil, out / spoil, 0)) for spoil in SPOILS}


def linear(scene: Scene) -> np.ndarray:
    """(PHOTOS, 64, 64, 3)"""
    return linear_from_srgb(np.stack([read_photo(frame.image, frame.mask).srgb for frame in scene.frames]))


def test_a_clean_copy_is_the_scene(scene, copies):
    before, after = read_scene(scene / "transforms_train.json"), copies["clean"]
    assert np.abs(linear(after) - linear(before)).max() < 0.01
    for a, b in zip(before.frames, after.frames, strict=True):
        np.testing.assert_allclose(a.camera_to_world, b.camera_to_world, atol=1e-12)
    np.testing.assert_array_equal(read_mesh(after.mesh).vertices, read_mesh(scene / "mesh.obj").vertices)


def test_the_same_seed_spoils_the_same_way(scene, copies, tmp_path):
    for spoil in ("people", "highlights", "poses"):
        again = read_scene(spoilt(scene, spoil, tmp_path / spoil, 0))
        np.testing.assert_array_equal(linear(again), linear(copies[spoil]))
        assert (again.frames[1].camera_to_world == copies[spoil].frames[1].camera_to_world).all()
    other = read_scene(spoilt(scene, "people", tmp_path / "other", 1))
    assert (linear(other) != linear(copies["people"])).any()


def test_photos_are_spoilt_as_they_should_be(copies):
    clean = linear(copies["clean"])
    for photo in linear(copies["clipped"]):
        assert (photo.max(axis=2) > 0.999).mean() == pytest.approx(CLIPPED, abs=0.06)
    np.testing.assert_allclose(linear(copies["dark"]), clean / 16.0, atol=0.004)
    changed = (np.abs(linear(copies["people"]) - clean) > 0.02).any(axis=3).mean(axis=(1, 2))
    assert 1 <= (changed > 0).sum() <= 8
    assert changed[changed > 0].min() > 0.7 * COVERED[0] and changed.max() < 1.1 * COVERED[1]
    glint = linear(copies["highlights"]) - clean
    assert glint.min() > -0.01 and 0.02 < (glint > 0.1).any(axis=3).mean() < 0.6


def test_meshes_and_poses_are_a_little_off(scene, copies):
    mesh, true = read_mesh(copies["mesh"].mesh), read_mesh(scene / "mesh.obj")
    off = np.linalg.norm(mesh.vertices - true.vertices, axis=1) / Frame3D.bounding(true.vertices).extent
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.003, rel=0.3)
    np.testing.assert_array_equal(mesh.uvs, true.uvs)
    for frame, before in zip(copies["poses"].frames, copies["clean"].frames, strict=True):
        turn = before.camera_to_world[:3, :3].T @ frame.camera_to_world[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert 0.0 < np.abs(turn - np.eye(3)).max() * frame.camera.params[0] < 5.0


def test_unmasked_photos_show_what_is_behind(copies):
    assert all(frame.mask is None for frame in copies["unmasked"].frames)
    assert (np.ptp(linear(copies["unmasked"])[:, 0], axis=1) > 0.0).any()


def test_the_table_has_a_line_for_each_spoil():
    rows = [
        Row("bust", spoil, variant, 20.0, 25.0 + number)
        for spoil in ("clean", "people")
        for number, variant in enumerate(VARIANTS)
    ]
    lines = table(rows, "bust").splitlines()
    assert lines[0] == f"| bust | {' | '.join(VARIANTS)} |" and len(lines) == 4
    assert lines[3].startswith("| people | 20.00 / 25.00 | 20.00 / 26.00 |")
