"""Shading normals: a mesh's own, or smooth ones that keep edges."""

import numpy as np
import pytest
from dante_w.rays.normals import corner_normals
from dante_w.rays.scene3d import face_geometry
from dante_w.scene.mesh import Mesh


def sphere(count=32):
    """A unit sphere of 2 x count x (2 count) triangles, each corner with a vertex of its own, as files have them at seams."""
    theta, phi = np.linspace(0.0, np.pi, count + 1), np.linspace(0.0, 2.0 * np.pi, 2 * count + 1)
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    grid = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=2)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3)
    return mesh(np.round(corners, 12).reshape(-1, 3, 3))


def cube():
    """The unit cube's faces, looking outwards."""
    square = np.array([[(0, 0, 1), (1, 0, 1), (1, 1, 1)], [(0, 0, 1), (1, 1, 1), (0, 1, 1)]], float)
    sides = [square, (1.0, 0.0, 1.0) + square * (1.0, 1.0, -1.0) * (-1.0, 1.0, 1.0)]
    return mesh(np.concatenate([np.roll(side, turn, axis=2) for side in sides for turn in range(3)]))


def mesh(corners, normals=None):
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), None, normals)


def normals_of(of):
    corners = of.vertices[of.faces]
    flat = face_geometry(corners, np.zeros((len(corners), 3, 2)))[0]
    return corner_normals(of, corners, flat), flat, corners


def degrees(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1.0, 1.0)))


def test_smooth_surfaces_have_smooth_normals_across_seams():
    found, flat, corners = normals_of(sphere())
    solid = np.linalg.norm(flat, axis=1) > 0.0
    assert degrees(flat[solid][:, None], corners[solid]).max() > 2.0
    assert degrees(found[solid], corners[solid]).max() < 0.6
    assert found.dtype == np.float32 and (found[~solid] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(found[solid], axis=2), 1.0, atol=1e-6)


def test_noise_of_a_scan_is_averaged_out():
    random = np.random.default_rng(0)
    plane = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 30)] * 2), axis=2)
    plane = np.concatenate([plane, random.normal(0.0, 0.003, (30, 30, 1))], axis=2)
    a, b, c, d = plane[:-1, :-1], plane[:-1, 1:], plane[1:, 1:], plane[1:, :-1]
    found, flat, _ = normals_of(
        mesh(np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3))
    )
    up = np.array([0.0, 0.0, 1.0])
    assert degrees(found.mean(axis=1), up).mean() < 0.5 * degrees(flat, up).mean()


def test_edges_stay_sharp():
    found, flat, _ = normals_of(cube())
    np.testing.assert_allclose(found, np.repeat(flat[:, None], 3, axis=1), atol=1e-6)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_a_meshs_own_normals_win_where_they_are_sound(order):
    of = sphere(8)
    own = of.vertices[of.faces][:, order] * 5.0  # of any length; the wrong corners' if turned round
    spoilt = own.copy()
    spoilt[0, 0], spoilt[3, 1], spoilt[5, 2] = np.nan, 0.0, -spoilt[5, 2]  # the last on the wrong side alone
    found, flat, _ = normals_of(Mesh(of.vertices, of.faces, None, spoilt.astype(np.float32)))
    smooth = normals_of(of)[0]
    wanted = own / np.linalg.norm(own, axis=2, keepdims=True)
    for face, corner in ((0, 0), (3, 1)):
        wanted[face, corner] = smooth[face, corner]
    solid = np.linalg.norm(flat, axis=1) > 0.0
    np.testing.assert_allclose(found[solid], wanted[solid], atol=1e-6)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("own", [False, True])
def test_faces_may_be_wound_either_way(own):
    of = sphere(12)
    normals = of.vertices[of.faces].astype(np.float32) if own else None
    before = normals_of(Mesh(of.vertices, of.faces, None, normals))[0]
    faces = of.faces.copy()
    faces[::3] = faces[::3, ::-1]
    normals = of.vertices[faces].astype(np.float32) if own else None
    after = normals_of(Mesh(of.vertices, faces, None, normals))[0]
    after[::3] = -after[::3, ::-1]
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_a_fan_of_very_many_faces_takes_no_time():
    angle = np.linspace(0.0, 2.0 * np.pi, 200_001)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    corners = np.stack([np.full_like(rim[:-1], (0.0, 0.0, 0.1)), rim[:-1], rim[1:]], axis=1)
    found = normals_of(mesh(corners))[0]
    assert degrees(found[:, 0], np.array([0.0, 0.0, 1.0])).max() < 0.2


def test_moving_scaling_and_repeating_changes_nothing():
    of = sphere(12)
    before = normals_of(of)[0]
    moved = Mesh(1e-5 * of.vertices + 7.0, of.faces, None)
    assert degrees(normals_of(moved)[0], before)[(before != 0.0).any(axis=2)].max() < 0.1
    np.testing.assert_array_equal(normals_of(of)[0], before)
