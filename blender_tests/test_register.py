"""Turning the add-on on and off."""

import bpy

import dante_w_addon
from dante_w_addon.blender import survey


def ours():
    """What of the add-on Blender knows."""
    classes = {name for name in dir(bpy.types) if name.startswith("DANTEW_")}
    return classes, hasattr(bpy.types.Scene, "dante_w"), list(bpy.app.handlers.load_pre)


def test_register_and_unregister_leave_nothing_behind():
    before = ours()
    for _ in range(2):
        dante_w_addon.register()
        classes, settings, handlers = ours()
        assert {"DANTEW_OT_recover", "DANTEW_PT_recover", "DANTEW_PT_relight"} <= classes
        assert settings and len(handlers) == len(before[2]) + 2
        dante_w_addon.unregister()
        assert ours() == before


def test_settings_have_their_defaults(addon):
    settings = bpy.context.scene.dante_w
    assert (settings.preset, settings.texture_size, settings.device) == ("standard", "AUTO", "auto")
    assert settings.hdri == "city"  # the first that ships with Blender


def test_operators_say_what_they_need(addon, standin, scene):
    assert bpy.ops.dantew.recover.poll()
    assert not bpy.ops.dantew.cancel.poll()
    assert not bpy.ops.dantew.show.poll()
    bpy.context.view_layer.objects.active = bpy.data.objects["Camera 0"]
    assert not bpy.ops.dantew.recover.poll()
    assert bpy.ops.dantew.relight.poll()
    scene.camera = None
    assert not bpy.ops.dantew.relight.poll()


def test_recover_is_off_without_photos(addon, standin, scene):
    for camera in bpy.data.cameras:
        camera.background_images.clear()
    assert not bpy.ops.dantew.recover.poll()


def test_survey_finds_what_is_wrong(addon, standin, scene):
    cube = bpy.data.objects["Cube"]

    def problems():
        survey._cache = None
        return survey.examine(scene, cube).problems

    assert problems() == ()
    scene.dante_w.prior_folder = "/no/such/folder"
    assert "priors" in problems()[0]
    scene.dante_w.prior_folder = ""
    cube.data.uv_layers.remove(cube.data.uv_layers[0])
    assert "no UV map" in problems()[0]
    scene.dante_w.unwrap = True
    assert problems() == ()


def test_render_of_another_shape_is_noticed_and_matched(addon, scene):
    cube = bpy.data.objects["Cube"]
    scene.render.resolution_x, scene.render.resolution_y = 128, 96  # the photos are 64 x 48
    assert not survey.examine(scene, cube).overlay_off
    scene.render.resolution_x = 96
    assert survey.examine(scene, cube).overlay_off
    bpy.ops.dantew.match_render()
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)
    assert not survey.examine(scene, cube).overlay_off
