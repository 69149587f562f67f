"""Gradient-domain texturing on a painted sheet of paper, photographed without light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.scene_folder import Camera, Frame, Scene, write_scene
from dante_w.scene.cameras import directions
from dante_w.scene.images import read_texture
from dante_w.scene.load import load_scene
from dante_w.scene.mesh import Mesh, write_obj
from measure.metrics import srgb_from_linear
from measure.pictures import write
from methods import lagrange_texturing

SIZE = 192  # photos and texture
RAYS = 4  # along each side of a pixel
CAMERA = Camera("PINHOLE", SIZE, SIZE, (180.0, 190.0, 101.0, 92.0))
EYES = np.array([(0.0, 0.0, 2.9), (0.9, 0.5, 2.8), (-0.8, 0.7, 2.8), (0.3, -0.9, 2.9)])
FAR_AWAY = np.array([4000.0, -3000.0, 500.0])  # units of its own, as georeferenced captures have


def colour(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(..., 3) sRGB of the paint at texture coordinates; unlike itself mirrored or turned."""
    ripple = 0.15 * np.sin(9.0 * u + 4.0 * v)
    return np.stack([0.2 + 0.6 * u + ripple * (1 - u), 0.2 + 0.6 * v + ripple * v, 0.5 + ripple], axis=-1)


def sheet() -> Mesh:
    """The square |x|, |y| < 1 in z = 0: its left half on the texture as it lies, its right half mirrored, and one
    triangle without area in the UVs."""
    x, y = np.array([-1, 0, 1, -1, 0, 1]), np.array([-1, -1, -1, 1, 1, 1])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [0, 1, 0]])
    left = np.stack([0.08 + 0.36 * (x + 1), 0.1 + 0.4 * (y + 1)], axis=1)
    right = np.stack([0.92 - 0.36 * x, 0.1 + 0.4 * (y + 1)], axis=1)
    uvs = np.concatenate([left[faces[:2]], right[faces[2:4]], left[faces[4:]]])
    vertices = np.stack([x, y, np.zeros(6)], axis=1)
    return Mesh(1000.0 * vertices + FAR_AWAY, faces, uvs)


def pose(eye: np.ndarray) -> np.ndarray:
    """(4, 4) OpenGL camera-to-world, looking from `eye` at the origin, y up."""
    back = eye / np.linalg.norm(eye)
    right = np.cross((0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return matrix


def photo(camera_to_world: np.ndarray) -> np.ndarray:
    """(SIZE, SIZE, 4) what a pinhole camera sees of the sheet: sRGB times alpha, and alpha."""
    steps = (np.arange(RAYS * SIZE) + 0.5) / RAYS
    column, row = np.meshgrid(steps, steps)
    rays = directions(CAMERA, np.stack([column.ravel(), row.ravel()], axis=1)) @ camera_to_world[:3, :3].T
    eye = camera_to_world[:3, 3]
    x, y = (eye[:2] - rays[:, :2] * (eye[2] / rays[:, 2:])).T
    inside = (abs(x) < 1) & (abs(y) < 1)
    u = np.where(x < 0, 0.08 + 0.36 * (x + 1), 0.92 - 0.36 * x)
    seen = np.column_stack([colour(u, 0.1 + 0.4 * (y + 1)) * inside[:, None], inside])
    return seen.reshape(SIZE, RAYS, SIZE, RAYS, 4).mean(axis=(1, 3))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    folder.mkdir()
    write_obj(folder / "mesh.obj", sheet())
    frames = []
    for index, eye in enumerate(EYES):
        camera_to_world = pose(eye)
        write(folder / f"{index}.png", photo(camera_to_world))
        camera_to_world[:3, 3] = 1000.0 * camera_to_world[:3, 3] + FAR_AWAY
        frames.append(Frame(folder / f"{index}.png", CAMERA, camera_to_world))
    write_scene(folder, Scene(folder, folder / "mesh.obj", frames))
    return folder


def run(monkeypatch: pytest.MonkeyPatch, scene: Path, out: Path) -> int:
    command = ["lagrange_texturing.py", str(scene), "--out", str(out), "--texture-size", str(SIZE)]
    monkeypatch.setattr("sys.argv", command)
    return lagrange_texturing.main()


def truth() -> tuple[np.ndarray, np.ndarray]:
    """The paint (SIZE, SIZE, 3) at every texel, and (SIZE, SIZE) where the sheet lies, less its border."""
    steps = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(steps, 1.0 - steps)
    on_sheet = (abs(abs(u - 0.5) - 0.24) < 0.14) & (abs(v - 0.5) < 0.34)
    return colour(u, v), on_sheet


def shift(texture: np.ndarray, paint: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(2,) by how many texels, down and to the right, the texture lies off the paint; least squares."""
    slopes = np.stack([np.gradient(paint, axis=axis)[where].ravel() for axis in (0, 1)], axis=1)
    return np.linalg.lstsq(slopes, (paint - texture)[where].ravel(), rcond=None)[0]


def test_paint_comes_back_where_it_was(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, scene, tmp_path / "out") == 0
    texture, (paint, on_sheet) = srgb_from_linear(read_texture(tmp_path / "out" / "albedo.png")), truth()
    assert np.abs(texture - paint)[on_sheet].mean() < 0.003
    left = np.arange(SIZE) < SIZE // 2
    for island in (left, ~left):
        assert np.abs(shift(texture, paint, on_sheet & island)).max() < 0.1
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()][:3] == [
        "read photos",
        "project",
        "composite",
    ]


@pytest.mark.parametrize("index", range(len(EYES)))
def test_background_is_not_painted_on_the_mesh(scene: Path, index: int) -> None:
    """Where a photo is not foreground, its colour counts for nothing: here half-transparent blue."""
    loaded, mesh = load_scene(scene)
    write(loaded.frames[index].image, np.full((SIZE, SIZE, 4), (0.0, 0.0, 0.5, 0.5)))
    texture, (paint, on_sheet) = lagrange_texturing.texture_of(mesh, loaded.frames, SIZE), truth()
    assert np.abs(texture - paint)[on_sheet].mean() < 0.003


def test_what_lagrange_cannot_do_is_said(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    loaded, _ = load_scene(scene)
    bent = Camera("OPENCV", SIZE, SIZE, (*CAMERA.params, 0.1, 0.0, 0.0, 0.0))
    frames = [Frame(frame.image, bent, frame.camera_to_world) for frame in loaded.frames]
    write_scene(scene, Scene(scene, loaded.mesh, frames))
    assert run(monkeypatch, scene, tmp_path / "out") == 2
    assert "undistort" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_corners_are_welded_as_far_as_lagrange_takes_them() -> None:
    """Two triangles share an edge; a third runs through it in the first one's direction."""
    names = np.array([[7, 3, 5], [3, 7, 9]])
    first, corners = lagrange_texturing.welded(names)
    assert len(first) == 4
    assert (names.ravel()[first][corners] == names).all()
    names = np.vstack([names, [7, 3, 2], [9, 7, 1]])
    first, corners = lagrange_texturing.welded(names)
    assert (names.ravel()[first][corners] == names).all()
    assert len(set(corners[[0, 2]].ravel())) == 6
    assert corners[1, 1] == corners[3, 1] and corners[1, 2] == corners[3, 0]
    assert not set(corners[[0, 2]].ravel()) & set(corners[[1, 3]].ravel())
