"""Relit previews: what is rendered, and light where it should be."""

import math

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from relit import CITY, FOREST, TINY, relit, state
from small_scene import add_camera, add_cube, build, save_picture

from dante_w_addon.blender import hdris, pictures, studio
from dante_w_addon.operators import relight

RED = (1.0, 0.0, 0.0, 1.0)

pytestmark = pytest.mark.usefixtures("no_temporary_files")


def save_hdri(path, pixels):
    """Write an environment, (H, W, 3) from below."""
    height, width, _ = pixels.shape
    image = bpy.data.images.new("environment", width, height, float_buffer=True)
    image.pixels.foreach_set(np.dstack([pixels, np.ones((height, width))]).astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(path), "HDR"
    image.save()
    bpy.data.images.remove(image)
    return path


@pytest.fixture
def black(tmp_path):
    """An environment without light."""
    return save_hdri(tmp_path / "black.hdr", np.zeros((4, 8, 3)))


def shine(obj, image):
    """Give `obj` a material that emits what `image` shows."""
    material = bpy.data.materials.new("Lit")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    texture, emission, output = (
        tree.nodes.new(f"ShaderNode{name}") for name in ("TexImage", "Emission", "OutputMaterial")
    )
    texture.image = image
    tree.links.new(texture.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    obj.data.materials.clear()
    obj.data.materials.append(material)


def is_red(picture):
    """Whether the middle of a picture is."""
    height, width = picture.shape[:2]
    red, green, blue = picture[height // 2, width // 2, :3]
    return red > 0.5 and green < 0.2 and blue < 0.2


def test_what_is_not_saved_is_rendered(scene, black):
    scene.view_settings.view_transform = "Standard"
    cube = bpy.data.objects["Cube"]
    image = bpy.data.images.new("Painted", 8, 8)
    shine(cube, image)
    cube.data.transform(Matrix.Scale(0.01, 4))
    image.pixels.foreach_set(np.tile(np.float32(RED), 64))
    assert image.is_dirty
    assert not is_red(relit(black)), "too small to be seen"
    bpy.context.view_layer.objects.active = cube
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(cube.data)
    bmesh.ops.scale(mesh, vec=(100.0, 100.0, 100.0), verts=mesh.verts)
    bmesh.update_edit_mesh(cube.data)
    saves = []
    bpy.app.handlers.save_pre.append(lambda *_: saves.append(1))
    before = state()
    assert is_red(relit(black))
    assert state() == before and cube.mode == "EDIT" and image.is_dirty and not saves


def test_relative_paths_and_linked_libraries_are_found(tmp_path, black):
    save_picture(tmp_path / "library" / "red.png", 8, 8, RED)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library" / "library.blend"))
    shine(add_cube("Linked"), bpy.data.images.load("//red.png"))
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (tmp_path / "user").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "user" / "user.blend"))
    library = "//../library/library.blend"
    with bpy.data.libraries.load(library, link=True, relative=True) as (_, wanted):
        wanted.objects = ["Linked"]
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    scene.collection.objects.link(wanted.objects[0])
    scene.camera = add_camera("Camera", (6.0, 0.0, 3.0))
    bpy.context.view_layer.update()
    assert is_red(relit(black))
    assert [linked.filepath for linked in bpy.data.libraries] == [library]


def test_hidden_objects_are_left_out(scene, tmp_path, black):
    scene.view_settings.view_transform = "Standard"
    save_picture(tmp_path / "red.png", 8, 8, RED)
    shine(bpy.data.objects["Cube"], bpy.data.images.load(str(tmp_path / "red.png")))
    assert is_red(relit(black))
    bpy.data.objects["Cube"].hide_set(True)
    assert not is_red(relit(black))


def test_the_devices_of_the_preferences_are_used(scene, tmp_path):
    def preferences():
        return bpy.context.preferences.addons["cycles"].preferences

    preferences().refresh_devices()
    scene.cycles.device = "GPU"
    for used, level in ((True, "OFF"), (False, "FULL")):
        preferences().kernel_optimization_level = level
        for device in preferences().devices:
            device.use = used
        if used:
            studio.write_copy(bpy.context, tmp_path, [FOREST], TINY)
    studio.render_copy(tmp_path)
    assert preferences().kernel_optimization_level == "OFF"
    assert len(preferences().devices) and all(device.use for device in preferences().devices)


def test_lamps_are_left_out(scene, black):
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    lamp.data.energy = 10.0
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    assert relit(black)[..., :3].max() < 0.02


def test_light_turns_with_the_rotation(tmp_path):
    pixels = np.zeros((32, 64, 3))
    pixels[:, 30:34] = 20.0  # the middle of an environment image lies at -x: all light comes from there
    hdri = save_hdri(tmp_path / "half.hdr", pixels)
    add_cube()
    bpy.context.scene.camera = add_camera("Camera", (0.0, 0.0, 8.0))
    bpy.data.objects["Cube"].data.transform(Matrix.Rotation(math.radians(45), 4, "Y"))
    bpy.context.view_layer.update()  # from above: a roof with one slope to -x and one to +x
    brightness = []
    for rotation in (0.0, math.pi):
        picture = relit(hdri, studio.Look(rotation, 1.0, 16, 64))
        height, width = picture.shape[:2]
        row = picture[height // 2, :, :3].mean(axis=-1)
        brightness.append(row[width // 2 - 4 : width // 2].mean() - row[width // 2 : width // 2 + 4].mean())
    assert brightness[0] * brightness[1] < 0.0 and min(map(abs, brightness)) > 0.02


def test_strength_brightens(scene):
    means = [relit(FOREST, studio.Look(0.0, strength, 4, 64))[..., :3].mean() for strength in (0.2, 1.0)]
    assert means[1] > 1.5 * means[0]


def test_contact_sheet_of_all_presets(addon, scene, monkeypatch):
    monkeypatch.setattr(relight, "TILE_SIZE", 64)
    scene.dante_w.samples = 1
    before = state()
    bpy.ops.dantew.relight(every=True)
    assert state() == before
    sheet = bpy.data.images[relight.SHEET]
    assert len(hdris.presets()) == 8
    step_x, step_y = 64 + pictures.GAP, 48 + pictures.GAP
    width, height = 4 * step_x - pictures.GAP, 2 * step_y - pictures.GAP
    assert tuple(sheet.size) == (width, height)
    pixels = np.array(sheet.pixels).reshape(height, width, 4)
    corners = [(step_x * column, step_y * row) for row in (1, 0) for column in range(4)]
    tiles = [pixels[y : y + 48, x : x + 64] for x, y in corners]
    means = [tile[..., :3].mean() for tile in tiles]
    assert len({round(float(mean), 4) for mean in means}) == 8, "each light gives its own picture"


def test_labels_are_written_into_the_corner(tmp_path):
    if bpy.app.version < (4, 3, 0):
        pytest.skip("this Blender cannot write text into images")
    path = tmp_path / "a.png"
    save_picture(path, 200, 150, (0.2, 0.2, 0.2, 1.0))
    pictures.write_label(path, "Forest")
    picture = pictures.read_picture(path)[..., :3]
    assert picture[:30, :100].max() > 0.9 and picture[:30, :100].min() < 0.1
    assert picture[40:] == pytest.approx(51 / 255, abs=0.005)


def test_contact_sheet_order():
    tiles = [np.full((2, 3, 4), value, np.float32) for value in (0.1, 0.2, 0.3)]
    sheet = pictures.contact_sheet(tiles, columns=2)
    assert sheet[-1, 0, 0] == np.float32(0.1) and sheet[-1, -1, 0] == np.float32(0.2)
    assert sheet[0, 0, 0] == np.float32(0.3) and sheet[0, -1, 0] == 0.0


def test_portrait_renders_keep_their_shape(tmp_path):
    build(tmp_path / "photos", size=(48, 96))
    assert relit(CITY).shape[:2] == (64, 32)
