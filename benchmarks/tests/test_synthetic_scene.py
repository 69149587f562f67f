"""The synthetic scene is what it says: a mesh the product takes, photos of its albedo times its light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from dante_w.scene.images import read_photo
from dante_w.scene.load import load_scene
from dante_w.texture.check_uvs import check_uvs
from measure.metrics import srgb_from_linear
from measure.synthetic_scene import (
    BACKGROUND,
    DISTANCE,
    SphereSamples,
    albedo_at,
    bumpy_sphere,
    light_at,
    pose,
    sphere_points,
    write_photos,
    write_scene_folder,
)


def test_the_mesh_is_closed_and_faces_outwards() -> None:
    mesh = bumpy_sphere(20)
    assert len(mesh.faces) == 4 * 20 * 19
    check_uvs(mesh.uvs, Path("sphere"))
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1)) > 0.0).all()
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-12)  # as of any closed surface
    uv_sides = mesh.uvs[:, 1:] - mesh.uvs[:, :1]
    np.testing.assert_allclose(np.linalg.det(uv_sides).sum() / 2.0, 1.0 - 1.0 / 20, rtol=1e-12)


def test_cameras_look_at_the_centre_from_all_around() -> None:
    poses = np.stack([pose(index, 50) for index in range(50)])
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)
    places = poses[:, :3, 3]
    np.testing.assert_allclose(places, DISTANCE * poses[:, :3, 2])  # they look along their own -z
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=0.05 * DISTANCE)


def test_a_photo_shows_albedo_times_light(tmp_path: Path) -> None:
    mesh, side = bumpy_sphere(60), 256
    frame = write_photos(tmp_path, mesh, side, 2)[1]
    photo = read_photo(frame.image).srgb
    assert photo.shape == (side, side, 3)
    np.testing.assert_allclose(photo[0, 0], BACKGROUND, atol=0.02)

    # where each triangle's middle falls in the photo, for those that face the camera
    middle, uv = mesh.vertices[mesh.faces].mean(axis=1), mesh.uvs.mean(axis=1)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    eye = frame.camera_to_world[:3, 3]
    x, y, z = ((middle - eye) @ frame.camera_to_world[:3, :3]).T
    focal, _, centre, _ = frame.camera.params
    column, row = (centre - focal * x / z).astype(int), (centre + focal * y / z).astype(int)
    near = (normals @ (eye / DISTANCE) > 0.6) & (np.abs(uv[:, 1] - 0.5) < 0.3)
    expected = srgb_from_linear(albedo_at(uv) * light_at(normals, 1)).clip(0.0, 1.0)
    difference = np.abs(photo[row, column] - expected)[near]
    assert near.sum() > 500
    assert np.median(difference) < 0.03
    wrong_light = srgb_from_linear(albedo_at(uv) * light_at(normals, 0)).clip(0.0, 1.0)
    assert np.median(np.abs(photo[row, column] - wrong_light)[near]) > 0.06


def test_a_scene_repeats_its_photos(tmp_path: Path) -> None:
    mesh = bumpy_sphere(8)
    frames = write_photos(tmp_path, mesh, 16, 2)
    for photos in (5, 3):  # the second scene takes the first one's place
        write_scene_folder(tmp_path, mesh, frames, photos)
        scene, read = load_scene(tmp_path)
        names = [frame.image.name for frame in scene.frames]
        assert names == ["16_000.jpg", "16_001.jpg", "16_000.jpg", "16_001.jpg", "16_000.jpg"][:photos]
        np.testing.assert_array_equal(scene.frames[1].camera_to_world, pose(1, 2))
        np.testing.assert_array_equal(read.uvs, mesh.uvs)


def test_points_lie_where_texture_coordinates_say() -> None:
    uv = np.array([[0.0, 0.5], [0.25, 0.5], [0.7, 1.0]])
    np.testing.assert_allclose(sphere_points(uv), [[1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_samples_show_albedo_times_light_of_their_photo() -> None:
    data = SphereSamples(3, 40, torch.float64)
    assert data.ranges.tolist() == [[0, 40], [40, 80], [80, 120]]
    found = data.samples(np.array([5, 45, 119]), torch.device("cpu"))
    assert found.photo.tolist() == [0, 1, 2]
    uv, position = found.uv.numpy(), found.position.numpy()
    np.testing.assert_allclose(position, sphere_points(uv) / 2 + 0.5, atol=1e-7)
    light = np.concatenate([light_at(sphere_points(uv[k : k + 1]), k) for k in range(3)])
    np.testing.assert_allclose(found.colour.numpy(), srgb_from_linear(albedo_at(uv) * light), atol=1e-3)
