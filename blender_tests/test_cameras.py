"""A point lands on the same pixel in Blender and in the backend, whatever the camera."""

import json
import math
import subprocess

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from dante_w_addon.contract.errors import BadInput
from mathutils import Matrix, Vector
from small_scene import add_camera, add_cube, save_picture

from dante_w_addon.blender import cameras, scene_import
from dante_w_addon.bridge import export
from dante_w_addon.contract import scene_folder

LANDSCAPE, PORTRAIT, SQUARE = (640, 480), (480, 640), (512, 512)
# photo size, pixel aspect (x, y), and what is set on the camera
CASES = {
    "landscape": (LANDSCAPE, (1, 1), {}),
    "portrait": (PORTRAIT, (1, 1), {}),
    "square": (SQUARE, (1, 1), {"lens": 28.5}),
    "horizontal portrait": (PORTRAIT, (1, 1), {"sensor_fit": "HORIZONTAL", "sensor_width": 23.6}),
    "vertical landscape": (LANDSCAPE, (1, 1), {"sensor_fit": "VERTICAL", "sensor_height": 15.7}),
    "shifted landscape": (LANDSCAPE, (1, 1), {"shift_x": 0.13, "shift_y": -0.07}),
    "shifted portrait": (PORTRAIT, (1, 1), {"shift_x": -0.21, "shift_y": 0.11}),
    "shifted vertical": (LANDSCAPE, (1, 1), {"sensor_fit": "VERTICAL", "shift_x": 0.2, "shift_y": 0.1}),
    "tall pixels": (LANDSCAPE, (1, 1.5), {"shift_x": 0.1, "shift_y": 0.2}),
    "wide pixels": (PORTRAIT, (2, 1), {"shift_x": -0.1, "shift_y": 0.05}),
    "pixels turn the fit": (LANDSCAPE, (1, 1.5), {"sensor_fit": "AUTO", "lens": 80.0}),
    "wide pixels vertical": (SQUARE, (1.3, 1), {"sensor_fit": "VERTICAL", "shift_y": -0.1}),
}


def points(seed=0, around=(0.0, 0.0, 0.0)):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (40, 3)) + around


def blender_pixels(scene, camera, cloud):
    """Where Blender itself sees the points, with the render size at the photo's."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    seen = [world_to_camera_view(scene, camera, Vector(point)) for point in cloud]
    return np.array([(x * width, (1.0 - y) * height) for x, y, _ in seen])


def backend_pixels(python, folder, cloud, tmp_path):
    file = tmp_path / "points.json"
    file.write_text(json.dumps(np.asarray(cloud).tolist()))
    script = str(__import__("pathlib").Path(__file__).with_name("project.py"))
    done = subprocess.run(
        [python, script, str(folder), str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout), float)


def export_now(folder):
    scene = bpy.context.scene
    mesh = next(obj for obj in scene.objects if obj.type == "MESH")
    export.export_scene(scene, mesh, bpy.context.evaluated_depsgraph_get(), folder)
    return folder


@pytest.mark.parametrize("name", CASES)
def test_blender_and_backend_agree(name, tmp_path, backend_python):
    size, aspect, settings = CASES[name]
    scene = bpy.context.scene
    add_cube()
    save_picture(tmp_path / "a.png", *size)
    camera = add_camera("Camera", (4.0, -5.0, 3.0), photo=tmp_path / "a.png")
    for key, value in settings.items():
        setattr(camera.data, key, value)
    # A camera may carry scale, and turn about its view.
    camera.matrix_world = camera.matrix_world @ Matrix.Rotation(0.4, 4, "Z") @ Matrix.Diagonal((2, 0.5, 3, 1))
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    bpy.context.view_layer.update()
    cloud = points()
    expected = blender_pixels(scene, camera, cloud)
    got = backend_pixels(backend_python, export_now(tmp_path / "scene"), cloud, tmp_path)[0]
    assert np.abs(got - expected).max() < 0.01


def test_render_size_does_not_matter(tmp_path):
    """The rule for a photo whose shape differs from the render's: it is read as if the render had its size."""
    add_cube()
    for name, size in (("wide", LANDSCAPE), ("tall", PORTRAIT)):
        save_picture(tmp_path / f"{name}.png", *size)
        camera = add_camera(name, (5.0, 0.0, 0.0), photo=tmp_path / f"{name}.png")
        camera.data.shift_x = 0.1
    found = []
    for render in (LANDSCAPE, PORTRAIT, SQUARE):
        bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = render
        read = scene_folder.read_scene(export_now(tmp_path / "scene"))
        found.append([frame.camera for frame in read.frames])
    assert found[0] == found[1] == found[2]
    wide, tall = sorted(found[0], key=lambda camera: -camera.width)
    assert (wide.width, wide.height, tall.width, tall.height) == (*LANDSCAPE, *PORTRAIT)
    assert wide.params[0] == pytest.approx(50.0 / 36.0 * 640) and tall.params[0] == pytest.approx(
        50.0 / 36.0 * 640
    )


def test_constraints_and_parents_count(tmp_path):
    add_cube()
    save_picture(tmp_path / "a.png", *SQUARE)
    camera = add_camera("Camera", (5.0, 0.0, 0.0), photo=tmp_path / "a.png")
    parent = bpy.data.objects.new("Parent", None)
    parent.location = (0.0, 0.0, 7.0)
    bpy.context.scene.collection.objects.link(parent)
    camera.parent = parent
    limit = camera.constraints.new("LIMIT_LOCATION")
    limit.use_max_x, limit.max_x = True, 4.0
    bpy.context.view_layer.update()
    pose = scene_folder.read_scene(export_now(tmp_path / "scene")).frames[0].camera_to_world
    assert pose[:3, 3] == pytest.approx((4.0, 0.0, 7.0))


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        (Matrix.Diagonal((-1, 1, 1, 1)), "mirrored"),
        (Matrix(((1, 0.5, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))), "sheared"),
    ],
)
def test_impossible_cameras_are_refused(matrix, said):
    with pytest.raises(BadInput, match=said):
        cameras.pose(matrix)


CALIBRATIONS = {
    "pinhole": scene_folder.Camera("PINHOLE", 640, 480, (700.0, 700.0, 301.5, 250.25)),
    "one focal": scene_folder.Camera("SIMPLE_RADIAL", 640, 480, (700.0, 320.0, 240.0, -0.12)),
    "opencv": scene_folder.Camera("OPENCV", 480, 640, (700.0, 703.0, 240.0, 320.0, 0.1, -0.02, 0.001, 0.002)),
    "two focals": scene_folder.Camera("PINHOLE", 640, 480, (700.0, 700.4, 320.0, 240.0)),
    "tall pixels": scene_folder.Camera("PINHOLE", 640, 480, (900.0, 700.0, 320.0, 250.0)),
}


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_import_and_export_return_the_same_scene(name, tmp_path):
    calibration = CALIBRATIONS[name]
    source = write_folder(tmp_path / "source", calibration)
    made = scene_import.import_folder(bpy.context, source)
    distorted = calibration.model != "PINHOLE" or name == "two focals"
    assert bool(made.warnings) == distorted, made.warnings
    assert made.mesh is not None and tuple(made.mesh.data.vertices[0].co) == pytest.approx((1.0, 2.0, 3.0))
    background = made.cameras[0].data.background_images[0]
    assert background.frame_method == "CROP" and tuple(background.image.size) == (
        calibration.width,
        calibration.height,
    )
    before = scene_folder.read_scene(source)
    after = scene_folder.read_scene(export_now(tmp_path / "again"))
    assert after.frames[0].camera.model == calibration.model
    assert after.frames[0].camera.params == pytest.approx(calibration.params, abs=1e-3)
    if distorted:
        assert after.frames[0].camera.params == calibration.params, "kept exactly"
    for old, new in zip(before.frames, after.frames, strict=True):
        assert np.abs(old.camera_to_world - new.camera_to_world).max() < 1e-5
        assert old.image.read_bytes() == new.image.read_bytes()


def test_an_edited_lens_wins_over_the_imported_calibration(tmp_path):
    made = scene_import.import_folder(bpy.context, write_folder(tmp_path / "source", CALIBRATIONS["opencv"]))
    made.cameras[0].data.lens *= 1.5
    camera = scene_folder.read_scene(export_now(tmp_path / "again")).frames[0].camera
    assert camera.model == "PINHOLE" and camera.params[0] == pytest.approx(1050.0)


def test_a_broken_folder_imports_nothing(addon, tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(RuntimeError, match=r"transforms\.json"):
        bpy.ops.dantew.import_scene(filepath=str(tmp_path))
    assert not bpy.data.cameras and not bpy.context.scene.collection.children


def write_folder(folder, calibration):
    """A scene folder of one triangle and two photos."""
    folder.mkdir()
    (folder / "mesh.obj").write_text("v 1 2 3\nv 4 2 3\nv 1 5 3\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    frames = []
    for index in range(2):
        photo = folder / "images" / f"{index}.png"
        save_picture(photo, calibration.width, calibration.height, (0.1 * index, 0.5, 0.5, 1.0))
        angle = 0.3 + index
        pose = np.eye(4)
        pose[:3, :3] = (
            (math.cos(angle), -math.sin(angle), 0),
            (math.sin(angle), math.cos(angle), 0),
            (0, 0, 1),
        )
        pose[:3, 3] = (1.0, 2.0, 3.0 + index)
        frames.append(scene_folder.Frame(photo, calibration, pose))
    scene_folder.write_scene(
        folder, scene_folder.Scene(folder / "transforms.json", folder / "mesh.obj", frames)
    )
    return folder
