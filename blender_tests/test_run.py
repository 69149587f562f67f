"""A recovery from button to material, with the stand-in backend."""

import time

import bpy
import pytest
from running import finish

from dante_w_addon.blender import material
from dante_w_addon.bridge import job
from dante_w_addon.bridge.progress import SILENCE
from dante_w_addon.ui import elements, panels


def test_to_done(addon, standin, scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    cube = bpy.data.objects["Cube"]
    assert bpy.ops.dantew.recover() == {"FINISHED"}
    assert not bpy.ops.dantew.recover.poll(), "one at a time"
    progress = finish()
    assert progress.state == "done", progress.message
    assert progress.loss == pytest.approx(0.2)
    assert material.display_of(cube) == "ALBEDO"
    texture = cube.active_material.node_tree.nodes.active.image
    assert texture.packed_file and texture.colorspace_settings.name == "sRGB"
    assert [round(255 * value) for value in texture.pixels[:3]] == [200, 120, 40]
    assert elements.expectation(progress.expected) == "About 40 s; 25 dB on test objects"
    assert progress.step.stage == "optimise", "an expectation is not a stage, nor is a plan"
    assert [(decision.what, decision.choice) for decision in progress.plan] == [("groups", "one light")]
    report = material.report_of(cube)
    assert ("Time (expected)", "42 s (40 s)") in panels.facts(report)
    assert report["python_variables"] == [], "the environment was not stripped"
    assert report["arguments"][report["arguments"].index("--preset") + 1] == "standard"
    assert (tmp_path / "dante_w" / "Cube" / "result" / "albedo.png").is_file()


def test_options_reach_the_backend(addon, standin, scene, tmp_path):
    settings = scene.dante_w
    settings.preset, settings.texture_size, settings.device = "draft", "1024", "cuda"
    settings.file_format, settings.unwrap, settings.prior_folder = "exr", True, str(tmp_path)
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.data.objects["Cube"])["arguments"])
    for words in ("--preset draft", "--texture-size 1024", "--format exr", "--unwrap"):
        assert words in said
    assert f"--priors {tmp_path}" in said
    assert "--irradiance traced" in said and "--model" not in said and "--leave-out" not in said
    assert "--device" not in said, "traced light runs on the CPU"
    settings.model_groups, settings.model_gloss, settings.texture_size = "ON", "OFF", "AUTO"
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.context.view_layer.objects.active)["arguments"])
    for words in ("--irradiance traced", "--model groups", "--leave-out gloss"):
        assert words in said
    assert said.count("--model") == said.count("--leave-out") == 1 and "--texture-size" not in said
    settings.irradiance, settings.preset = "field", "paper"  # it has no such components
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.context.view_layer.objects.active)["arguments"])
    for words in ("--irradiance field", "--preset paper", "--device cuda"):
        assert words in said
    assert "--model" not in said and "--leave-out" not in said


def test_files_of_a_former_run_are_not_taken(addon, standin, scene, tmp_path):
    out = tmp_path / "dante_w" / "Cube" / "result"
    out.mkdir(parents=True)
    (out / "albedo.exr").write_text("old")
    (out / "mesh.obj").write_text("old")
    bpy.ops.dantew.recover()
    assert finish().state == "done"
    cube = bpy.data.objects["Cube"]
    assert cube.active_material.node_tree.nodes.active.image.file_format == "PNG"
    assert "DANTE-W" not in cube.data.uv_layers


def test_new_uvs_that_do_not_fit_go_to_a_new_object(addon, standin, scene):
    cube = bpy.data.objects["Cube"]
    cube.modifiers.new("Finer", "SUBSURF").levels = 1
    scene.dante_w.unwrap = True
    bpy.ops.dantew.recover()
    progress = finish()
    made = bpy.context.view_layer.objects.active
    assert made != cube and made.name in progress.message
    assert material.display_of(made) == "ALBEDO" and material.display_of(cube) is None
    assert made.visible_get() and not cube.visible_get()


def test_switch_keeps_the_old_material(addon, standin, scene):
    cube = bpy.data.objects["Cube"]
    original = cube.active_material
    for _ in range(2):  # a second recovery must not take the first albedo for an original
        bpy.ops.dantew.recover()
        finish()
    bpy.ops.dantew.show(which="ORIGINAL")
    assert cube.active_material == original and material.display_of(cube) == "ORIGINAL"
    bpy.ops.dantew.show(which="ALBEDO")
    assert cube.active_material != original and material.display_of(cube) == "ALBEDO"
    assert original.users > 0, "the original would be lost on saving"


def test_object_without_material_goes_back_to_none(addon, standin, scene):
    cube = bpy.data.objects["Cube"]
    cube.data.materials.clear()
    bpy.ops.dantew.recover()
    finish()
    assert cube.active_material is not None
    bpy.ops.dantew.show(which="ORIGINAL")
    assert cube.active_material is None


def test_result_survives_saving(addon, standin, scene, tmp_path):
    bpy.ops.dantew.recover()
    finish()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    cube = bpy.data.objects["Cube"]
    assert material.display_of(cube) == "ALBEDO"
    material.show(cube, "ORIGINAL")
    assert cube.active_material.name == "Original"


def test_renamed_object_still_gets_its_texture(addon, standin, scene):
    bpy.ops.dantew.recover()
    bpy.data.objects["Cube"].name = "Renamed"
    assert finish().state == "done"
    assert material.display_of(bpy.data.objects["Renamed"]) == "ALBEDO"


@pytest.mark.parametrize(
    ("mode", "code", "said"), [("crash", 1, "something unforeseen"), ("bad", 2, "no UVs")]
)
def test_failure_keeps_the_scene_and_says_why(addon, standin, scene, mode, code, said):
    standin(mode)
    cube = bpy.data.objects["Cube"]
    before = (cube.active_material, sorted(cube.keys()), len(bpy.data.images), len(bpy.data.materials))
    bpy.ops.dantew.recover()
    progress = finish()
    assert (progress.state, progress.code) == ("failed", code)
    assert said in progress.message
    assert before == (
        cube.active_material,
        sorted(cube.keys()),
        len(bpy.data.images),
        len(bpy.data.materials),
    )


def test_silence_is_noticed(addon, standin, scene):
    standin("silent")
    bpy.ops.dantew.recover()
    end = time.monotonic() + 10.0
    while not job.recovery.progress.plan:  # the last line it says
        job.tick()
        assert time.monotonic() < end
    assert not job.recovery.progress.silent
    job.recovery.progress.last_time -= 2 * SILENCE  # as if so long ago
    job.tick()
    assert job.recovery.progress.silent >= 2 * SILENCE


def test_unsaved_file_packs_the_images(addon, standin, tmp_path):
    from small_scene import build

    cube = build(tmp_path / "photos")
    bpy.context.scene.dante_w.storage = "FILE"
    bpy.ops.dantew.recover()
    assert finish().state == "done"
    assert cube.active_material.node_tree.nodes.active.image.packed_file
