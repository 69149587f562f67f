import math

import numpy as np
import pycolmap
import pytest
from dante_w.contract.errors import BadInput
from dante_w.contract.scene_folder import Camera
from dante_w.scene.cameras import check_camera, directions, project
from hypothesis import given
from hypothesis import strategies as st

WIDTH, HEIGHT = 640, 480
MODELS = sorted(set(pycolmap.CameraModelId.__members__) - {"INVALID", "EQUIRECTANGULAR"})


def distorted(model: str) -> Camera:
    """A camera of the model with every distortion parameter a little away from 0, none alike."""
    plain = pycolmap.Camera.create_from_model_name(0, model, 500.0, WIDTH, HEIGHT).params
    params = [value if abs(value) > 1e-9 else 0.004 / (i + 1) for i, value in enumerate(plain)]
    return Camera(model, WIDTH, HEIGHT, tuple(params))


def grid() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0.5, WIDTH - 0.5, 9), np.linspace(0.5, HEIGHT - 0.5, 7))
    return np.stack([x, y], axis=-1).reshape(-1, 2)


def turned(angle: float, centre: tuple[float, float, float]) -> np.ndarray:
    """A pose turned by `angle` about the world's y axis."""
    pose = np.eye(4)
    pose[0, 0] = pose[2, 2] = math.cos(angle)
    pose[0, 2], pose[2, 0] = math.sin(angle), -math.sin(angle)
    pose[:3, 3] = centre
    return pose


@pytest.mark.parametrize("model", MODELS)
def test_rays_project_back_to_their_pixels(model):
    camera, pose = distorted(model), turned(0.7, (3.0, -2.0, 5.0))
    rays = directions(camera, grid())
    assert np.all(rays[:, 2] == -1.0)
    depths = np.linspace(0.5, 20.0, len(rays))[:, None]
    points = (depths * rays) @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(project(camera, pose, points), grid(), atol=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_projections_equal_those_of_pycolmap(model):
    camera, pose = distorted(model), turned(-0.4, (0.1, 0.2, 0.3))
    points = np.random.default_rng(0).normal((0.5, 0.0, -3.0), 0.3, (50, 3))
    colmap = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=list(camera.params))
    flip = np.diag([1.0, -1.0, -1.0])
    rotation = flip @ pose[:3, :3].T
    cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ pose[:3, 3])
    expected = [colmap.img_from_cam(cam_from_world * point) for point in points]
    np.testing.assert_allclose(project(camera, pose, points), expected, atol=1e-9)


def test_axes_follow_opengl():
    camera = Camera("PINHOLE", 100, 80, (50.0, 50.0, 50.0, 40.0))
    rays = directions(camera, np.array([[50.0, 40.0], [100.0, 40.0], [50.0, 0.0]]))
    np.testing.assert_array_equal(rays, [[0, 0, -1], [1, 0, -1], [0, 0.8, -1]])


def test_simple_radial_has_its_closed_form():
    camera = Camera("SIMPLE_RADIAL", WIDTH, HEIGHT, (500.0, 320.0, 240.0, 0.1))
    x, y = 0.3, -0.2
    factor = 1.0 + 0.1 * (x * x + y * y)
    expected = [[320.0 + 500.0 * x * factor, 240.0 + 500.0 * y * factor]]
    np.testing.assert_allclose(project(camera, np.eye(4), np.array([[x, -y, -1.0]])), expected, atol=1e-10)


def test_equidistant_fisheye_has_its_closed_form():
    camera = Camera("OPENCV_FISHEYE", WIDTH, HEIGHT, (200.0, 200.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0))
    for angle in (0.1, 0.8, 1.5):
        (ray,) = directions(camera, np.array([[320.0 + 200.0 * angle, 240.0]]))
        assert math.atan2(ray[0], -ray[2]) == pytest.approx(angle, abs=1e-7)


def test_a_fisheye_ray_beyond_90_degrees_is_not_finite():
    camera = Camera("OPENCV_FISHEYE", WIDTH, HEIGHT, (200.0, 200.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0))
    rays = directions(camera, np.array([[320.0 + 200.0 * 1.6, 240.0], [320.0, 240.0]]))
    assert np.isfinite(rays).all(axis=1).tolist() == [False, True]


def test_a_distortion_without_inverse_gives_no_ray():
    camera = Camera("SIMPLE_RADIAL", WIDTH, HEIGHT, (500.0, 320.0, 240.0, -0.3))
    rays = directions(camera, np.array([[0.0, 0.0], [320.0, 240.0]]))  # r (1 - 0.3 r^2) never reaches 0.8
    assert np.isfinite(rays).all(axis=1).tolist() == [False, True]


@pytest.mark.parametrize("model", MODELS)
def test_points_behind_the_camera_are_nan(model):
    points = np.array([[0.1, 0.1, 2.0], [0.1, 0.1, 0.0], [0.1, 0.1, -2.0]])
    pixels = project(distorted(model), np.eye(4), points)
    assert np.isnan(pixels).all(axis=1).tolist() == [True, True, False]


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_no_pixels_give_no_rays(model):
    assert directions(distorted(model), np.empty((0, 2))).shape == (0, 3)
    assert project(distorted(model), np.eye(4), np.empty((0, 3))).shape == (0, 2)


coordinate = st.floats(-1e4, 1e4)


@given(
    focal=st.tuples(st.floats(10.0, 1e5), st.floats(10.0, 1e5)),
    centre=st.tuples(coordinate, coordinate),
    pixel=st.tuples(coordinate, coordinate),
    position=st.tuples(*[st.floats(-1e6, 1e6)] * 3),
    angle=st.floats(-math.pi, math.pi),
    depth=st.floats(0.1, 1e3),
)
def test_pinhole_round_trip(focal, centre, pixel, position, angle, depth):
    camera, pose = Camera("PINHOLE", 100, 100, (*focal, *centre)), turned(angle, position)
    ray = directions(camera, np.array([pixel]))
    point = (depth * ray) @ pose[:3, :3].T + pose[:3, 3]
    # a position of 1e6 costs 1e-10 of the point, seen through the focal length from `depth`
    error = 1e-8 + 1e-9 * max(focal) / depth * (1.0 + np.abs(ray).max())
    np.testing.assert_allclose(project(camera, pose, point), [pixel], atol=error)


@pytest.mark.parametrize(
    "camera",
    [
        Camera("PINHOLE", 4, 4, (1.0, 2.0, 3.0)),
        Camera("OPENCV", 4, 4, (1.0, 2.0)),
        Camera("NO_SUCH", 4, 4, (1.0, 2.0, 3.0, 4.0)),
        Camera("INVALID", 4, 4, ()),
        Camera("OPENCV", 2**40, 4, (1.0,) * 8),
        Camera("EQUIRECTANGULAR", 4, 4, (4.0, 4.0)),
    ],
)
def test_impossible_cameras_are_bad_input(camera):
    with pytest.raises(BadInput):
        directions(camera, np.zeros((1, 2)))
    with pytest.raises(BadInput):
        project(camera, np.eye(4), np.array([[0.0, 0.0, -1.0]]))
    with pytest.raises(BadInput):
        check_camera(camera)


def test_a_camera_that_is_not_finite_is_bad_input():
    with pytest.raises(BadInput, match="not finite"):
        check_camera(Camera("PINHOLE", 4, 4, (math.nan, 1.0, 2.0, 2.0)))
    check_camera(Camera("PINHOLE", 4, 4, (1.0, 1.0, 2.0, 2.0)))
