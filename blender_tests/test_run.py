"""A recovery from button to material, with the stand-in backend."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import bpy
import pytest
from conftest import HERE, ROOT

from dante_w_addon.blender import material
from dante_w_addon.bridge import job
from dante_w_addon.bridge.process import SILENCE, STAGES, Progress, decisions
from dante_w_addon.ui import panels


def finish(seconds=20.0):
    """Tick as Blender's timer would, until the recovery has ended."""
    end = time.monotonic() + seconds
    while job.tick() is not None:
        assert time.monotonic() < end, "the recovery did not end"
        time.sleep(0.02)
    return job.recovery.progress


def alive(pid):
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"  # a zombie has ended
    except (ProcessLookupError, FileNotFoundError):  # it may end between these lines
        return False


def test_to_done(addon, standin, scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    cube = bpy.data.objects["Cube"]
    assert bpy.ops.dantew.recover() == {"FINISHED"}
    assert not bpy.ops.dantew.recover.poll(), "one at a time"
    progress = finish()
    assert progress.state == "done", progress.message
    assert progress.loss == pytest.approx(0.2)
    assert material.shown(cube) == "ALBEDO"
    texture = cube.active_material.node_tree.nodes.active.image
    assert texture.packed_file and texture.colorspace_settings.name == "sRGB"
    assert [round(255 * value) for value in texture.pixels[:3]] == [200, 120, 40]
    assert panels.expectation(progress.expected) == "About 40 s, 25 dB on test objects"
    assert progress.stage == "optimise", "an expectation is not a stage, nor is a plan"
    assert [(line["what"], line["choice"]) for line in progress.plan] == [("groups", "one light")]
    report = material.report_of(cube)
    assert ("Took (expected)", "42 s (40 s)") in panels.facts(report)
    assert report["python_variables"] == [], "the environment was not stripped"
    assert report["arguments"][report["arguments"].index("--preset") + 1] == "standard"
    assert (tmp_path / "dante_w" / "Cube" / "result" / "albedo.png").is_file()


@pytest.mark.parametrize(
    ("expected", "said"),
    [
        ({}, ""),
        ({"total_seconds": None}, ""),
        ({"total_seconds": 200.0}, "About 3 min"),
        ({"total_seconds": 20.0, "albedo_psnr_after_gain": None}, "About 20 s"),
    ],
)
def test_what_the_backend_leaves_open_is_left_out(expected, said):
    assert panels.expectation(expected) == said
    lines = dict(panels.facts({"seconds": {"bake": 1.0}, "expected": expected}))
    assert ("Took" in lines) == (said == "")


def test_lines_of_a_plan_that_say_too_little_are_left_out():
    whole = {"what": "gloss", "choice": "on", "reason": "all surfaces shine", "costs": "time"}
    assert decisions([whole, {"what": "gloss"}, {**whole, "reason": 3}, "gloss"]) == [whole]
    assert decisions(None) == decisions({"what": "gloss"}) == []


def test_stages_are_counted_whichever_model_runs():
    for stages in STAGES.values():
        number, of = Progress(stage=stages[-4]).place
        assert (number, of) == (len(stages) - 3, len(stages)) and stages[number - 1] == stages[-4]
    assert Progress(stage="resting").place == (0, 0)


def test_panels_draw_a_plan(addon, standin, scene):
    """In a window they are drawn with a layout; here with one that notes what it is told."""
    bpy.ops.dantew.recover()
    plan = finish().plan
    said = []

    class Layout(SimpleNamespace):
        def panel(self, idname, default_closed):
            assert default_closed
            return self, self

        def column(self, **_):
            return self

        def label(self, text, **_):
            said.append(text)

    system = SimpleNamespace(ui_scale=1.0)
    context = SimpleNamespace(preferences=SimpleNamespace(system=system), region=SimpleNamespace(width=600))
    panels._draw_plan(context, Layout(), plan)
    assert said == ["Plan", "Groups: one light", "held-out photos say so"]
    said.clear()
    panels._draw_plan(context, Layout(), [])
    assert said == []


def test_options_reach_the_backend(addon, standin, scene, tmp_path):
    settings = scene.dante_w
    settings.preset, settings.texture_size, settings.device = "draft", "1024", "cpu"
    settings.file_format, settings.unwrap, settings.prior_folder = "exr", True, str(tmp_path)
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.data.objects["Cube"])["arguments"])
    for words in ("--preset draft", "--texture-size 1024", "--device cpu", "--format exr", "--unwrap"):
        assert words in said
    assert f"--priors {tmp_path}" in said
    assert "--irradiance traced" in said and "--model" not in said and "--leave-out" not in said
    settings.model_groups, settings.model_gloss, settings.texture_size = "ON", "OFF", "AUTO"
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.context.view_layer.objects.active)["arguments"])
    for words in ("--irradiance traced", "--model groups", "--leave-out gloss"):
        assert words in said
    assert said.count("--model") == said.count("--leave-out") == 1 and "--texture-size" not in said
    settings.irradiance = "field"  # it has no such parts
    bpy.ops.dantew.recover()
    finish()
    said = " ".join(material.report_of(bpy.context.view_layer.objects.active)["arguments"])
    assert "--irradiance field" in said and "--model" not in said and "--leave-out" not in said


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
    assert material.shown(made) == "ALBEDO" and material.shown(cube) is None
    assert made.visible_get() and not cube.visible_get()


def test_switch_keeps_the_old_material(addon, standin, scene):
    cube = bpy.data.objects["Cube"]
    original = cube.active_material
    for _ in range(2):  # a second recovery must not take the first albedo for an original
        bpy.ops.dantew.recover()
        finish()
    bpy.ops.dantew.show(which="ORIGINAL")
    assert cube.active_material == original and material.shown(cube) == "ORIGINAL"
    bpy.ops.dantew.show(which="ALBEDO")
    assert cube.active_material != original and material.shown(cube) == "ALBEDO"
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
    assert material.shown(cube) == "ALBEDO"
    material.show(cube, "ORIGINAL")
    assert cube.active_material.name == "Original"


def test_renamed_object_still_gets_its_texture(addon, standin, scene):
    bpy.ops.dantew.recover()
    bpy.data.objects["Cube"].name = "Renamed"
    assert finish().state == "done"
    assert material.shown(bpy.data.objects["Renamed"]) == "ALBEDO"


@pytest.mark.parametrize("mode", ["slow", "stubborn"])
def test_cancel_within_a_second_leaves_no_orphan(addon, standin, scene, tmp_path, mode):
    standin(mode)
    bpy.ops.dantew.recover()
    child_file = tmp_path / "dante_w" / "Cube" / "scene" / "child.pid"
    while job.recovery.progress.stage != "optimise" or (mode == "stubborn" and not child_file.exists()):
        job.tick()
        time.sleep(0.02)
    time.sleep(0.1)
    pids = [job.recovery.process.pid]
    if mode == "stubborn":
        pids.append(int(child_file.read_text()))
    assert all(map(alive, pids))
    before = time.monotonic()
    bpy.ops.dantew.cancel()
    assert time.monotonic() - before < 0.5, "cancel must not wait"
    while any(map(alive, pids)):
        # a second, on a machine with nothing else to do
        assert time.monotonic() - before < 3.0, "still running"
        time.sleep(0.01)
    assert finish().state == "cancelled"
    assert material.shown(bpy.data.objects["Cube"]) is None


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


def test_opening_another_file_stops_the_backend(addon, standin, scene):
    standin("slow")
    bpy.ops.dantew.recover()
    pid = job.recovery.process.pid
    assert alive(pid)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not alive(pid)
    assert job.recovery is None


def test_silence_is_noticed(addon, standin, scene):
    standin("silent")
    bpy.ops.dantew.recover()
    end = time.monotonic() + 10.0
    while not job.recovery.progress.plan:  # the last line it says
        job.tick()
        assert time.monotonic() < end
    assert not job.recovery.progress.silent
    job.recovery.progress.heard -= 2 * SILENCE  # as if so long ago
    job.tick()
    assert job.recovery.progress.silent >= 2 * SILENCE


def test_unsaved_file_packs_the_images(addon, standin, tmp_path):
    from small_scene import build

    cube = build(tmp_path / "photos")
    bpy.context.scene.dante_w.storage = "FILE"
    bpy.ops.dantew.recover()
    assert finish().state == "done"
    assert cube.active_material.node_tree.nodes.active.image.packed_file


QUIT = """
import sys
sys.path[:0] = [{root!r}, {here!r}]
import bpy, dante_w_addon
from dante_w_addon import layout
from dante_w_addon.bridge import job
from pathlib import Path
layout.launcher = lambda: Path({here!r}) / "standin" / "launch.py"
bpy.ops.wm.open_mainfile(filepath={blend!r})
dante_w_addon.register()
bpy.ops.dantew.recover()
print(job.recovery.process.pid, flush=True)
{end}
"""


@pytest.mark.parametrize("end", ["", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"])
def test_quitting_or_killing_blender_leaves_no_backend(standin, scene, end):
    standin("slow")
    code = QUIT.format(root=str(ROOT), here=str(HERE), blend=bpy.data.filepath, end=end)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    pid = int(next(line for line in done.stdout.splitlines() if line.isdigit()))
    until = time.monotonic() + 3.0  # a killed Blender cannot stop it; its next line finds nobody listening
    while alive(pid):
        assert time.monotonic() < until
        time.sleep(0.02)
