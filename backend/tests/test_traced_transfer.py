"""Light transport against closed forms, and what shading points are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from dante_w.core.color import linear_from_srgb_array
from dante_w.rays.ray_cache import RayCache, Surface
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.mesh import Mesh
from dante_w.traced.light_transport import LightTransport, bounced, sphere, trace_light_transport
from dante_w.traced.pixel_weights import USUAL
from dante_w.traced.sample_geometry import shading_normals
from dante_w.traced.shading_points import USUAL_SHADING, ShadingPoints, cells, gather

SIDE = USUAL_SHADING.side

CHART = 8  # cells along either side of a quad's chart
CENTRE = np.array([[0.5, 0.5, 0.5]])


def quads(corners: np.ndarray, flipped: bool = False) -> Mesh:
    """A mesh of Q quads (Q, 4, 3), each with a chart of CHART x CHART cells of its own."""
    corners = np.asarray(corners, np.float64)
    count = len(corners)
    faces = np.array([[4 * q + i for i in half] for q in range(count) for half in ((0, 1, 2), (0, 2, 3))])
    chart = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64)
    uv = np.concatenate([(chart + np.array((q, 0))) * CHART / SIDE for q in range(count)])
    if flipped:
        faces = faces[:, ::-1]
    return Mesh(corners.reshape(-1, 3), np.ascontiguousarray(faces, np.int32), uv[faces])


def cache_of(
    mesh: Mesh, face: np.ndarray, bary: np.ndarray, colour: np.ndarray, starts: list[int]
) -> RayCache:
    assert mesh.uvs is not None
    corners = Frame3D.bounding(mesh.vertices).normalise(mesh.vertices)[mesh.faces]
    surface = Surface(torch.from_numpy(mesh.uvs).float(), torch.from_numpy(corners).float())
    encoded = np.rint(np.asarray(bary) * 65535.0).astype(np.uint16)
    return RayCache(
        surface, np.array(starts), np.asarray(face, np.int32), encoded, np.asarray(colour, np.float16), None
    )


def everywhere(mesh: Mesh, camera: np.ndarray = CENTRE) -> ShadingPoints:
    """Shading points on all faces, as a photo from `camera` would give them."""
    random = np.random.default_rng(0)
    each = 1500
    face = np.repeat(np.arange(len(mesh.faces)), each)
    bary = random.dirichlet((1.0, 1.0, 1.0), len(face))[:, 1:] * 0.997 + 0.001
    cache = cache_of(mesh, face, bary, np.full((len(face), 3), 0.5), [0, len(face)])
    return gather(cache, camera)[0]


def traced(mesh: Mesh, points: ShadingPoints, count: int = 64) -> LightTransport:
    frame = Frame3D.bounding(mesh.vertices)
    assert mesh.uvs is not None
    caster = Raycaster(mesh, frame)
    return trace_light_transport(points, caster, mesh.uvs, count, lambda _: None)


def one_point(
    mesh: Mesh, place: tuple[float, float, float], normal: tuple[float, float, float]
) -> ShadingPoints:
    """A single point; nothing else on the mesh was seen."""
    position = Frame3D.bounding(mesh.vertices).normalise(np.array([place])).astype(np.float32)
    return ShadingPoints(np.full(SIDE * SIDE, -1, np.int32), position, np.array([normal], np.float32))


def square(z: float = 0.0, half: float = 1.0) -> list[tuple[float, float, float]]:
    return [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]


def box() -> np.ndarray:
    """The unit cube's six faces, their normals inward."""
    made = []
    for axis in range(3):
        for side in (0.0, 1.0):
            quad = np.zeros((4, 3))
            quad[:, (axis + 1) % 3], quad[:, (axis + 2) % 3] = (0, 1, 1, 0), (0, 0, 1, 1)
            quad[:, axis] = side
            made.append(quad if side == 0.0 else quad[::-1])
    return np.array(made)


@pytest.mark.parametrize("count", [1, 64, 257])
def test_the_sphere_is_cut_evenly(count):
    directions = sphere(count)
    assert directions.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    if count > 1:
        np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=0.01)
        np.testing.assert_allclose(directions.T @ directions / count, np.eye(3) / 3.0, atol=0.01)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_an_open_plane_sees_the_whole_sky(normal):
    mesh = quads([square()])
    found = traced(mesh, one_point(mesh, (0.1, 0.3, 0.0), normal))
    assert found.direct.sum() == pytest.approx(1.0, abs=0.01)
    height = found.directions @ np.array(normal)
    assert (found.visible[0, height > 0.25] == 1.0).all()
    assert (found.visible[0, height < -0.25] == 0.0).all()
    straight = 4.0 / 64 * np.maximum(height, 0.0)
    np.testing.assert_allclose(found.direct[0], straight, atol=0.02)  # a direction stands for a patch
    assert found.lost.sum() < 1e-3 and len(found.indices) == 0


@pytest.mark.parametrize("height", [1.0, 3.0, 40.0])
def test_a_long_wall_takes_its_share(height):
    distance, length = 1.0, 100.0
    wall = [
        (distance, -length, 0),
        (distance, length, 0),
        (distance, length, height),
        (distance, -length, height),
    ]
    mesh = quads([square(half=0.5), wall])
    found = traced(mesh, one_point(mesh, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), 256)
    lift = 2e-4 * 2 * length
    # the view factor of a strip at a right angle to the point, which is lifted a little
    taken = 0.5 * (1.0 - distance / np.hypot(distance, height - lift))
    assert found.direct.sum() == pytest.approx(1.0 - taken, abs=0.012)
    assert found.lost.sum() == pytest.approx(taken, abs=0.07), "no photo saw the wall"
    hidden = found.visible[0, (found.directions[:, 0] > 0.8) & (abs(found.directions[:, 2] - 0.2) < 0.06)]
    assert len(hidden)
    assert (hidden == 0.0).all()


def test_in_a_closed_box_all_light_is_bounced():
    mesh = quads(box())
    points = everywhere(mesh)
    assert len(points) == 6 * CHART**2
    found = traced(mesh, points)
    assert found.direct.sum(axis=1).max() < 0.01
    assert found.indptr[0] == 0 and found.indptr[-1] == len(found.indices) == len(found.weight)
    assert found.lost.max() < 0.05, "photos saw everything"
    total = np.add.reduceat(found.weight, found.indptr[:-1]) + found.lost
    np.testing.assert_allclose(total, 1.0, atol=0.08)
    assert total.mean() == pytest.approx(1.0, abs=0.01)
    arriving = bounced(found, np.ones((len(points), 2), np.float32))
    np.testing.assert_allclose(arriving, total[:, None].repeat(2, axis=1), rtol=1e-4)


def test_bounced_light_comes_from_the_wall_it_left():
    mesh = quads(box())
    points = everywhere(mesh)
    found = traced(mesh, points)
    ceiling = points.position[:, 2] > 0.999
    arriving = bounced(found, ceiling[:, None].astype(np.float32))[:, 0]
    assert arriving[ceiling].max() < 0.02, "a plane does not light itself"
    floor = points.position[:, 2] < 0.001
    middle = floor & (np.abs(points.position[:, :2] - 0.5) < 0.1).all(axis=1)
    # from the centre of a face to the opposite one: four times a quarter's view factor
    quarter = 0.5 / np.sqrt(1.25)
    expected = 4.0 / (2.0 * np.pi) * 2.0 * quarter * np.arctan(quarter)
    assert arriving[middle].mean() == pytest.approx(expected, abs=0.03)


def test_unseen_parts_send_the_mean_of_what_leaves():
    none = np.zeros(0, np.int64)
    transfer = LightTransport(
        sphere(4),
        np.ones((3, 4), np.float32),
        np.ones((3, 4), np.float32),
        np.array([0, 1, 1, 1]),
        np.array([2]),
        np.array([0.5], np.float32),
        np.array([0.0, 0.25, 0.0], np.float32),
    )
    leaving = np.array([[1.0], [2.0], [6.0]], np.float32)
    np.testing.assert_allclose(bounced(transfer, leaving), [[3.0], [0.75], [0.0]])
    dark = LightTransport(transfer.directions, transfer.visible, transfer.direct, np.zeros(4, np.int64), none,
                    np.zeros(0, np.float32), np.zeros(3, np.float32))  # fmt: skip
    np.testing.assert_array_equal(bounced(dark, leaving), 0.0)


def test_flipped_faces_see_the_same_light():
    corners = box()[1:]  # open on one side
    plain, flipped = quads(corners), quads(corners, flipped=True)
    points = everywhere(plain)
    a, b = traced(plain, points), traced(flipped, points)
    assert 0.1 < a.direct.sum(axis=1).max() < 0.9
    np.testing.assert_allclose(a.visible, b.visible, atol=0.13)  # rays along an edge
    np.testing.assert_allclose(a.direct.sum(axis=1), b.direct.sum(axis=1), atol=0.005)
    leaving = np.ones((len(points), 1), np.float32)
    leaving[points.position[:, 2] < 0.001] = 0.2
    np.testing.assert_allclose(bounced(a, leaving), bounced(b, leaving), atol=0.02)
    assert np.abs(a.lost - b.lost).max() < 0.02


def test_the_back_of_what_photos_saw_sends_nothing_known():
    """A roof seen from above only: what leaves its lower side was not seen."""
    mesh = quads([square(0.0), square(1.0)])
    points = everywhere(mesh, np.array([[0.5, 0.5, 9.0]]))
    assert (points.normal[:, 2] > 0.99).all()
    found = traced(mesh, points)
    below = points.position[:, 2] < 0.5
    assert len(found.indices) == 0
    assert found.lost[below].min() > 0.1 and found.lost[~below].max() < 1e-3


def test_gather_averages_linear_colours_by_cell():
    mesh = quads([square()])
    # two pixels in one cell and one in another; then a second photo
    bary = np.array([(0.5, 0.2), (0.5, 0.202), (0.1, 0.8), (0.5, 0.2)])
    colour = np.array(
        [(0.2, 0.5, 0.9), (0.6, 0.5, 0.1), (0.3, USUAL.clipped_from + 0.004, 0.3), (0.4, 0.4, 0.4)]
    )
    cache = cache_of(mesh, [0, 0, 0, 0], bary, colour, [0, 3, 4])
    points, seen = gather(cache, np.array([[0.5, 0.5, 2.0], [0.6, 0.4, 2.0]]))
    assert len(points) == 2 and (points.point_of_cell >= 0).sum() == 2
    uvs = np.column_stack([bary.sum(axis=1), bary[:, 1]]) * CHART / SIDE
    first, other = points.at(uvs)[[0, 2]]
    assert first != other and points.at(uvs)[3] == first == points.at(uvs)[1]
    assert points.at(np.array([[0.9, 0.9], [0.5, 0.01]])).tolist() == [-1, -1]

    linear = linear_from_srgb_array(np.asarray(colour, np.float16).astype(np.float32))
    wanted = {(0, first): linear[:2].mean(axis=0), (0, other): linear[2], (1, first): linear[3]}
    assert {*zip(seen.photo.tolist(), seen.point.tolist(), strict=True)} == set(wanted)
    for row, key in enumerate(zip(seen.photo.tolist(), seen.point.tolist(), strict=True)):
        np.testing.assert_allclose(seen.colour[row], wanted[key], rtol=1e-4)
        assert seen.pixels[row] == (2 if key == (0, first) else 1)
        assert seen.clipped[row] == (key == (0, other))
    assert (np.diff(seen.photo) >= 0).all()
    part = seen.take(seen.photo == 1)
    assert len(part.point) == len(part.colour) == len(part.pixels) == len(part.clipped) == 1


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_normals_are_on_the_cameras_side(flipped, side):
    points = everywhere(quads([square()], flipped), np.array([[0.5, 0.5, 0.5 + side]]))
    np.testing.assert_allclose(points.normal, [(0.0, 0.0, side)] * len(points), atol=1e-6)


def test_points_lie_in_their_cells_and_photos_may_see_nothing():
    mesh = quads([square()])
    points = everywhere(mesh)
    uv = (points.position[:, :2] - 0.0) * CHART / SIDE
    assert points.at(uv).tolist() == list(range(len(points)))
    assert cells(np.array([[-0.1, 0.0], [1.0, 1.0], [0.0, 1.0 / SIDE]]), SIDE).tolist() == [
        0,
        SIDE**2 - 1,
        SIDE,
    ]
    half = cache_of(mesh, [0], [(0.3, 0.3)], [(0.5, 0.5, 0.5)], [0, 0, 1, 1])
    points, seen = gather(half, np.full((3, 3), 3.0))
    assert len(points) == 1 and seen.photo.tolist() == [1]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_face_is_seen_from_one_side_and_without_area_has_no_normal(side):
    corners = [[(0, 0, 0), (1, 0, 0), (0, 2, 0)], [(0, 0, 0), (1, 1, 1), (2, 2, 2)]]
    flat = Surface(torch.zeros(2, 3, 2), torch.tensor(corners, dtype=torch.float32))
    given = np.arange(2), np.full((2, 2), 20000, np.uint16), np.zeros((2, 3), np.float32), (0.1, 0.1, side)
    np.testing.assert_array_equal(shading_normals(flat, *given), [(0, 0, side), (0, 0, 0)])
    # a camera that sees the face at a grazing angle is still on the same side of it
    tilted = torch.tensor([[(0.8, 0.0, 0.6)] * 3, [(0.0, 0.0, 0.0)] * 3])
    given = *given[:3], (-1.0, 0.0, 0.1 * side)
    found = shading_normals(replace(flat, normals=tilted), *given)
    np.testing.assert_allclose(found, [(0.8 * side, 0, 0.6 * side), (0, 0, 0)], atol=1e-6)
