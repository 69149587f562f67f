"""Relighting in a process of its own: whatever the user does meanwhile, nothing of it is in the file but the picture."""

import os
import time

import bpy
import numpy as np
import pytest
from relit import CITY, FOREST, TINY, datablocks, relit, state, tick_until
from small_scene import add_cube

from dante_w_addon.blender import hdris, pictures, studio
from dante_w_addon.bridge.relighting import Relighting
from dante_w_addon.operators import relight

pytestmark = pytest.mark.usefixtures("no_temporary_files")


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
    assert relight.latest_image() == image


def test_undo_redo_save_and_delete_meanwhile(addon, scene, tmp_path):
    first = datablocks()
    bpy.ops.ed.undo_push(message="First")
    add_cube("Later")
    bpy.ops.ed.undo_push(message="Later")
    second = datablocks()
    assert first != second
    saved = str(tmp_path / "saved.blend")
    relight.watch(Relighting(bpy.context, [FOREST, CITY], TINY), "picture")
    for act, expected in (
        (lambda: {"FINISHED"}, second),
        (bpy.ops.ed.undo, first),
        (bpy.ops.ed.redo, second),
        (lambda: bpy.ops.wm.save_as_mainfile(filepath=saved, copy=True), second),
        (bpy.ops.ed.undo, first),
    ):
        relight.tick()
        assert act() == {"FINISHED"}
        relight.tick()
        assert datablocks() == expected
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    expected = datablocks()
    assert relight.active is not None, "it ended before anything could be tried"
    tick_until(lambda: relight.active is None)
    assert not relight.last_message
    assert tuple(bpy.data.images["picture"].size) == (2 * 64 + pictures.GAP, 48)
    expected["images"] = sorted([*expected["images"], "picture"])
    assert datablocks() == expected
    for act, before in (
        (bpy.ops.ed.redo, second),
        (bpy.ops.ed.undo, first),
    ):  # undo does not take the picture
        assert act() == {"FINISHED"}
        assert datablocks() == {**before, "images": sorted([*before["images"], "picture"])}
        assert tuple(relight.latest_image().size) == (2 * 64 + pictures.GAP, 48)
    bpy.ops.wm.open_mainfile(filepath=saved)
    assert datablocks() == second


def test_an_image_of_the_same_name_takes_the_picture(addon, scene):
    relight.watch(Relighting(bpy.context, [FOREST], TINY), "picture")
    bpy.data.images.new("picture", 7, 5)
    tick_until(lambda: relight.active is None)
    assert tuple(bpy.data.images["picture"].size) == (64, 48)


def test_cancel_leaves_nothing(addon, scene, tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    before, files = state(), os.listdir(bpy.app.tempdir)
    assert not bpy.ops.dantew.cancel_relight.poll()
    relight.watch(Relighting(bpy.context, list(hdris.presets().values()), TINY), "picture")
    assert not bpy.ops.dantew.relight.poll() and bpy.ops.dantew.cancel_relight.poll()
    tick_until(lambda: relight.active.files)
    relighting = relight.active
    started = time.monotonic()
    assert bpy.ops.dantew.cancel_relight() == {"FINISHED"}
    assert time.monotonic() - started < 1.0
    assert relight.active is None and not relight.last_message
    assert not relighting.update(), "its process lives on"
    assert state() == before and os.listdir(bpy.app.tempdir) == files and not os.listdir(temporary)
    assert relight.tick() is None and bpy.ops.dantew.relight.poll()


def test_opening_another_file_ends_a_running_preview(addon, scene):
    relight.watch(Relighting(bpy.context, [FOREST], TINY), "picture")
    assert not bpy.ops.dantew.relight.poll()
    relighting = relight.active
    bpy.ops.wm.read_homefile(use_empty=True)
    assert relight.active is None and not relighting.update()


def test_a_failing_render_is_one_sentence(scene, tmp_path):
    before = state()
    with pytest.raises(RuntimeError, match=r"^The preview failed: .*none\.hdr") as failure:
        relit(tmp_path / "none.hdr")
    assert "\n" not in str(failure.value)
    assert state() == before


@pytest.mark.parametrize("end", ["import os; os.abort()", "raise SystemExit(2)", "1 / 0", ""])
def test_a_process_that_ends_without_a_word_is_one_sentence(addon, scene, tmp_path, monkeypatch, end):
    script = tmp_path / "end.py"
    script.write_text(f"print('half a li', end='')\n{end}\n")
    monkeypatch.setattr(studio, "__file__", str(script))
    before = state()
    relight.watch(Relighting(bpy.context, [FOREST], TINY), "picture")
    tick_until(lambda: relight.active is None)
    assert relight.last_message.startswith("The preview failed: ") and "\n" not in relight.last_message
    assert state() == before
    with pytest.raises(RuntimeError, match="The preview failed: "):
        bpy.ops.dantew.relight()


def test_a_blender_that_cannot_be_started_is_one_sentence(addon, scene, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.executable", str(tmp_path / "none"))
    before = state()
    with pytest.raises(RuntimeError, match="The preview failed: "):
        bpy.ops.dantew.relight()
    assert state() == before


def test_own_file(addon, scene, tmp_path):
    scene.dante_w.hdri = hdris.OWN
    assert not bpy.ops.dantew.relight.poll()
    scene.dante_w.hdri_file = str(CITY)
    assert bpy.ops.dantew.relight.poll()
    assert hdris.file_of(hdris.OWN, str(tmp_path / "a.txt")) is None
