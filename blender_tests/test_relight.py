"""Relit previews: light where it should be, and nothing of the user's changed."""

import math

import bpy
import numpy as np
import pytest
from small_scene import add_camera, add_cube, build, save_picture

from dante_w_addon.blender import hdris, studio
from dante_w_addon.operators import relight

TINY = studio.Look(samples=4, size=64)


def state():
    """All that a preview might change."""
    scene = bpy.context.scene
    render = scene.render
    return (
        *(render.engine, render.resolution_x, render.resolution_y, render.resolution_percentage),
        *(
            render.filepath,
            render.image_settings.file_format,
            scene.cycles.samples,
            scene.cycles.use_denoising,
        ),
        *(scene.world, scene.camera, scene.frame_current, bpy.context.window.scene.name),
        *(
            sorted(data.name for data in group)
            for group in (bpy.data.scenes, bpy.data.worlds, bpy.data.objects)
        ),
    )


def half_lit_hdri(path):
    """An environment whose light all comes from -x."""
    image = bpy.data.images.new("half", 64, 32, float_buffer=True)
    pixels = np.zeros((32, 64, 4), np.float32)
    pixels[..., 3] = 1.0
    pixels[:, 30:34, :3] = 20.0  # the middle of an environment image lies at -x... see the test
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "HDR"
    image.save()
    bpy.data.images.remove(image)
    return path


def test_still_and_nothing_else_changes(addon, scene, monkeypatch):
    monkeypatch.setattr(relight, "STILL_SIZE", 64)
    settings = scene.dante_w
    settings.hdri, settings.samples = "forest", 4
    scene.render.filepath = "//somewhere"
    before = state()
    assert bpy.ops.dantew.relight() == {"FINISHED"}
    assert state() == before
    image = bpy.data.images[relight.PREVIEW]
    assert tuple(image.size) == (64, 48) and image.packed_file
    assert np.std(np.array(image.pixels)) > 0.02, "an empty picture"
    assert tuple(image.preview.image_size) == (64, 48)


def test_settings_survive_a_failing_render(scene, tmp_path, monkeypatch):
    def fail(**_):
        raise RuntimeError("no memory")

    before = state()
    monkeypatch.setattr(studio.Studio, "still", lambda *_: fail())
    with pytest.raises(RuntimeError), studio.Studio(bpy.context, TINY) as borrowed:
        studio.render_all(borrowed, studio.default_lights()[:1], tmp_path)
    assert state() == before


def test_a_scene_left_behind_is_removed_by_the_next_preview(scene):
    studio.Studio(bpy.context, TINY)  # never closed, as after undo
    assert len(bpy.data.scenes) == 2
    with studio.Studio(bpy.context, TINY):
        assert len(bpy.data.scenes) == 2
    assert list(bpy.data.scenes) == [scene]


def test_opening_another_file_forgets_a_running_preview(addon, scene):
    borrowed = studio.Studio(bpy.context, TINY)
    relight.active = relight.Relighting(borrowed, studio.default_lights(), "picture")
    assert not bpy.ops.dantew.relight.poll()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert relight.active is None


def test_lamps_are_left_out(scene, tmp_path):
    black = tmp_path / "black.hdr"
    image = bpy.data.images.new("black", 8, 4, float_buffer=True)
    image.filepath_raw, image.file_format = str(black), "HDR"
    image.save()
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    lamp.data.energy = 10.0
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    with studio.Studio(bpy.context, TINY) as borrowed:
        picture = studio.read_picture(borrowed.still(black, tmp_path / "a.png"))
    assert picture[..., :3].max() < 0.02


def test_light_turns_with_the_rotation(tmp_path):
    hdri = half_lit_hdri(tmp_path / "half.hdr")
    add_cube()
    bpy.context.scene.camera = add_camera("Camera", (0.0, 0.0, 8.0))
    bpy.data.objects["Cube"].data.transform(__import__("mathutils").Matrix.Rotation(math.radians(45), 4, "Y"))
    bpy.context.view_layer.update()  # from above: a roof with one slope to -x and one to +x
    brightness = []
    for rotation in (0.0, math.pi):
        look = studio.Look(rotation, 1.0, 16, 64)
        with studio.Studio(bpy.context, look) as borrowed:
            picture = studio.read_picture(borrowed.still(hdri, tmp_path / "a.png"))
        height, width = picture.shape[:2]
        row = picture[height // 2, :, :3].mean(axis=-1)
        brightness.append(row[width // 2 - 4 : width // 2].mean() - row[width // 2 : width // 2 + 4].mean())
    assert brightness[0] * brightness[1] < 0.0 and min(map(abs, brightness)) > 0.02


def test_strength_brightens(scene, tmp_path):
    means = []
    for strength in (0.2, 1.0):
        with studio.Studio(bpy.context, studio.Look(0.0, strength, 4, 64)) as borrowed:
            picture = studio.read_picture(borrowed.still(hdris.presets()["forest"], tmp_path / "a.png"))
        means.append(picture[..., :3].mean())
    assert means[1] > 1.5 * means[0]


def test_contact_sheet_of_all_presets(addon, scene, monkeypatch):
    monkeypatch.setattr(relight, "TILE_SIZE", 64)
    scene.dante_w.samples = 1
    before = state()
    bpy.ops.dantew.relight(every=True)
    assert state() == before
    sheet = bpy.data.images[relight.SHEET]
    assert len(hdris.presets()) == 8
    step_x, step_y = 64 + studio.GAP, 48 + studio.GAP
    width, height = 4 * step_x - studio.GAP, 2 * step_y - studio.GAP
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
    studio.write_label(path, "Forest")
    picture = studio.read_picture(path)[..., :3]
    assert picture[:30, :100].max() > 0.9 and picture[:30, :100].min() < 0.1
    assert picture[40:] == pytest.approx(51 / 255, abs=0.005)


def test_contact_sheet_order():
    tiles = [np.full((2, 3, 4), value, np.float32) for value in (0.1, 0.2, 0.3)]
    sheet = studio.contact_sheet(tiles, columns=2)
    assert sheet[-1, 0, 0] == np.float32(0.1) and sheet[-1, -1, 0] == np.float32(0.2)
    assert sheet[0, 0, 0] == np.float32(0.3) and sheet[0, -1, 0] == 0.0


def test_portrait_renders_keep_their_shape(tmp_path):
    build(tmp_path / "photos", size=(48, 96))
    with studio.Studio(bpy.context, TINY) as borrowed:
        picture = studio.read_picture(borrowed.still(hdris.presets()["city"], tmp_path / "a.png"))
    assert picture.shape[:2] == (64, 32)


def test_own_file(addon, scene, tmp_path):
    scene.dante_w.hdri = hdris.OWN
    assert not bpy.ops.dantew.relight.poll()
    scene.dante_w.hdri_file = str(hdris.presets()["city"])
    assert bpy.ops.dantew.relight.poll()
    assert hdris.file_of(hdris.OWN, str(tmp_path / "a.txt")) is None
