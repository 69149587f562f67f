"""Rays against closed forms on a square."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import cast
from dante_w.commands.cli import main
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Frame
from dante_w.rays import scene3d
from dante_w.rays.cast_photos import CastSettings
from dante_w.rays.ray_cache import RayCache, sample_bytes
from dante_w.rays.raycast import Frame3D, Raycaster, RaycastSettings
from dante_w.scene.load import load_scene
from square_scene import CAMERA, make_scene, pose

CPU = torch.device("cpu")


def cast_scene(folder: Path, spill: Path, **more) -> RayCache:
    loaded, mesh = load_scene(folder)
    spill.mkdir()
    return cast(mesh, loaded.frames, spill, **more)


def test_texture_coordinates_and_positions_are_where_the_pixel_looks(scene, tmp_path):
    seen: list = []
    cache = cast_scene(scene, tmp_path / "spill", visit=lambda uv, footprint, _: seen.append((uv, footprint)))
    frames = load_scene(scene)[0].frames
    for photo, frame in enumerate(frames):
        fx, fy, cx, cy = CAMERA.params
        x, y, height = frame.camera_to_world[:3, 3]
        columns, rows = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
        uv = np.column_stack(
            [(x + (columns - cx) / fx * height).ravel(), (y - (rows - cy) / fy * height).ravel()]
        )
        uv = uv[((uv > 0) & (uv < 1)).all(axis=1)]
        index = np.arange(cache.starts[photo], cache.starts[photo + 1])
        samples = cache.samples(index, CPU)
        # barycentrics are kept in 16 bits
        np.testing.assert_allclose(samples.uv, uv, atol=2e-5)
        np.testing.assert_allclose(samples.position[:, :2], uv, atol=2e-5)
        np.testing.assert_allclose(seen[photo][0], uv, atol=1e-6)
        assert (samples.photo == photo).all()
        # looking straight down, a pixel is height / focal length wide, and more where it looks aside
        assert seen[photo][1].min() == pytest.approx(height / fx, rel=0.02)


def test_the_surface_has_the_meshs_normals(scene, tmp_path):
    loaded, mesh = load_scene(scene)
    tilted = np.tile(np.float32((0.6, 0.0, 0.8)), (len(mesh.faces), 3, 1))
    up = np.cross(*(mesh.vertices[mesh.faces][0, 1:] - mesh.vertices[mesh.faces][0, 0]))[2]
    for normals, wanted in ((np.sign(up) * tilted, 0.6), (None, 0.0)):
        cache = cast(replace(mesh, normals=normals), loaded.frames, tmp_path)
        np.testing.assert_allclose(np.abs(cache.surface.normals.numpy()[..., 0]), wanted, atol=1e-6)


def test_a_sample_takes_at_most_24_bytes(scene, tmp_path):
    cache = cast_scene(scene, tmp_path / "spill")
    total = sum(array.nbytes for array in (cache.face, cache.bary, cache.colour))
    assert total <= 24 * len(cache)
    assert len(cache) > 0


def test_a_spilled_cache_holds_the_same_samples(scene, tmp_path):
    in_memory = cast_scene(scene, tmp_path / "a")
    on_disk = cast_scene(scene, tmp_path / "b", settings=CastSettings(share_of_memory=0.0))
    assert isinstance(on_disk.colour, np.memmap)
    assert not list((tmp_path / "a").iterdir())
    for name in ("face", "bary", "colour", "starts"):
        np.testing.assert_array_equal(getattr(in_memory, name), getattr(on_disk, name))
    whole = sample_bytes(prior=False) * len(on_disk)
    assert sum(file.stat().st_size for file in (tmp_path / "b").iterdir()) == whole
    on_disk.forget()
    np.testing.assert_array_equal(in_memory.colour, on_disk.colour)


def test_masked_pixels_make_no_samples(tmp_path):
    from dante_w.scene.images import write_png

    folder = make_scene(tmp_path / "scene", photos=1)
    whole = cast_scene(folder, tmp_path / "a")
    mask = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    mask[:18] = 255
    write_png(folder / "mask.png", mask)
    text = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(
        text.replace('"file_path"', '"mask_path": "mask.png", "file_path"')
    )
    masked = cast_scene(folder, tmp_path / "b")
    np.testing.assert_array_equal(masked.face, whole.face[: len(masked)])
    assert 0 < len(masked) < len(whole)


def test_cameras_that_look_away_are_bad_input(tmp_path):
    folder = make_scene(tmp_path / "scene", photos=1)
    loaded, mesh = load_scene(folder)
    frame = loaded.frames[0]
    away = Frame(frame.image, frame.camera, pose(0.5, 0.5, -3.0))
    with pytest.raises(BadInput, match="no pixel sees the mesh"):
        cast(mesh, [away], tmp_path)


def test_grazing_views_are_left_out(tmp_path):
    folder = make_scene(tmp_path / "scene", photos=1)
    loaded, mesh = load_scene(folder)
    flat = np.eye(4)
    # at the square's edge, looking along +y, 4 degrees above it
    tilt = np.radians(86.0)
    flat[:3, :3] = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    flat[:3, 3] = 0.5, -1.0, 0.1
    frame = Frame(loaded.frames[0].image, loaded.frames[0].camera, flat)
    with pytest.raises(BadInput):
        cast(mesh, [frame], tmp_path)


def test_a_far_offset_costs_no_precision(scene, tmp_path):
    from dante_w.scene.mesh import Mesh

    loaded, mesh = load_scene(scene)
    far = np.array([4.0e6, -1.0e7, 300.0])
    moved = [
        Frame(
            f.image,
            f.camera,
            np.block([[f.camera_to_world[:3, :3], (f.camera_to_world[:3, 3:] + far[:, None])], [0, 0, 0, 1]]),
        )
        for f in loaded.frames
    ]
    near = cast(mesh, loaded.frames, tmp_path)
    there = Mesh(mesh.vertices + far, mesh.faces, mesh.uvs)
    away = cast(there, moved, tmp_path)
    # 1e7 in float64 leaves 2e-9 units; a pixel at the square's edge may fall to either side
    assert abs(len(near) - len(away)) <= 2
    if len(near) == len(away):
        index = np.arange(len(near))
        np.testing.assert_allclose(near.samples(index, CPU).uv, away.samples(index, CPU).uv, atol=3e-5)


def test_priors_are_resized_to_their_photo(tmp_path):
    from dante_w.scene.images import write_png

    folder = make_scene(tmp_path / "scene", photos=2)
    (tmp_path / "priors").mkdir()
    write_png(tmp_path / "priors/0.png", np.full((18, 24, 3), 128, np.uint8))  # without alpha: to be trusted
    loaded, mesh = load_scene(folder, priors=tmp_path / "priors")
    cache = cast(mesh, loaded.frames, tmp_path)
    prior = cache.samples(np.arange(len(cache)), CPU).prior
    first = cache.starts[1]
    np.testing.assert_allclose(prior[:first, :3], 128 / 255, atol=1e-3)
    assert (prior[:first, 3] == 1.0).all()
    assert torch.isnan(prior[first:]).all()


def test_rays_without_direction_hit_nothing(scene):
    _, mesh = load_scene(scene)
    caster = Raycaster(mesh, Frame3D.bounding(mesh.vertices))
    hits = caster.cast(np.array([0.5, 0.5, 1.0]), np.array([[np.nan, 0, -1], [0, 0, -2.0], [0, 0, 1]]))
    assert hits.ray.tolist() == [1]
    assert hits.distance[0] == pytest.approx(0.25)  # the square lies at z = 0.5 of its unit cube


@pytest.mark.parametrize("size", [1 << 45, 1 << 62])  # more than there is, more than a number of bytes may be
def test_no_memory_for_the_mesh_is_said_before_embree_crashes(scene, tmp_path, monkeypatch, capsys, size):
    mesh = load_scene(scene)[1]
    settings = RaycastSettings(triangle_bytes=size)
    with pytest.raises(MemoryError):
        Raycaster(mesh, Frame3D.around(mesh), settings)
    monkeypatch.setattr(scene3d, "Raycaster", partial(Raycaster, settings=settings))
    assert main(["average", str(scene), "--out", str(tmp_path / "out")]) == 4
    assert "memory" in capsys.readouterr().err.splitlines()[-1]
