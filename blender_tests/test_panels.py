"""What the panels show: drawn with a layout that notes what it is given, as there is no window."""

import json
from types import SimpleNamespace

import bpy
import pytest
from conftest import ROOT
from dante_w_addon.contract.vocabulary import COMPONENTS, MODEL_PRESETS
from running import finish

from dante_w_addon.blender import material, properties
from dante_w_addon.bridge import job
from dante_w_addon.ui import elements, panels

OLD_REPORT = json.loads((ROOT / "backend/tests/old_report.json").read_text())


class Layout(SimpleNamespace):
    """Notes texts, properties and values of `prop_enum`; sub-panels are open."""

    def __init__(self, notes=None):
        super().__init__(notes=[] if notes is None else notes)

    def panel(self, idname, default_closed):
        assert default_closed
        return self.row(), self.row()

    def row(self, **_):
        return Layout(self.notes)

    column = split = box = row

    def label(self, text, **_):
        self.notes.append(text)

    def progress(self, text, **_):
        self.notes.append(text)

    def prop(self, data, name, **_):
        assert name in data.bl_rna.properties
        self.notes.append(name)

    def prop_enum(self, data, name, value):
        self.notes.append(f"{name} {value}")

    def operator(self, idname, **_):
        self.notes.append(idname)
        return SimpleNamespace()


def context():
    region = SimpleNamespace(width=2000)
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
    return SimpleNamespace(
        scene=bpy.context.scene, view_layer=bpy.context.view_layer, region=region, preferences=preferences
    )


def drawn(panel):
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), context())
    return layout.notes


@pytest.mark.parametrize(
    ("report", "line"),
    [
        ({}, None),
        ({"seconds": {"bake": 1.0}}, ("Time", "1 s")),
        ({"seconds": {"bake": 1.0}, "expected": {"total_seconds": None}}, ("Time", "1 s")),
        (
            {"seconds": {"bake": 1.0}, "expected": {"total_seconds": 200.0}},
            ("Time (expected)", "1 s (3 min)"),
        ),
        ({"held_out_psnr": None}, None),
    ],
)
def test_what_a_report_leaves_open_is_left_out(report, line):
    assert panels.facts(report) == [line] * (line is not None)


def test_an_old_result_is_shown(addon, scene):
    """A report of version 0.1.0, kept on an object as that version did."""
    cube = bpy.data.objects["Cube"]
    paint = bpy.data.materials.new("Cube albedo")
    cube["dante_w_originals"] = {"0": cube.active_material}
    cube["dante_w_albedo"], cube["dante_w_report"] = paint, json.dumps(OLD_REPORT)
    assert material.display_of(cube) == "ORIGINAL"
    notes = drawn(panels.DANTEW_PT_result)
    for text in ("26.5 dB", "98.8%", "512 x 512", "4 min (2 min)", "Several Lights: several lights"):
        assert text in notes
    assert "Specular: on" in notes and "22% of what points face is the mesh itself" in notes
    material.show(cube, "ALBEDO")
    assert cube.active_material == paint
    material.show(cube, "ORIGINAL")
    assert cube.active_material.name == "Original"


def test_a_report_that_is_none_is_no_error(addon, scene):
    cube = bpy.data.objects["Cube"]
    cube["dante_w_albedo"] = bpy.data.materials.new("Cube albedo")
    for text in ("", "{", "[1]", '"text"', '{"plan": 3, "seconds": 4, "settings": []}'):
        cube["dante_w_report"] = text
        assert "dantew.open_report" in drawn(panels.DANTEW_PT_result)


def test_the_plan_is_drawn(addon, standin, scene):
    bpy.ops.dantew.recover()
    plan, layout = finish().plan, Layout()
    elements.draw_plan(context(), layout, plan)
    assert layout.notes == ["Plan", "Several Lights: one light", "held-out photos say so"]
    layout.notes.clear()
    elements.draw_plan(context(), layout, ())
    assert layout.notes == []


def test_a_running_recovery_is_drawn(addon, standin, scene):
    standin("slow")
    bpy.ops.dantew.recover()
    while job.recovery.progress.loss is None:
        job.tick()
    notes = drawn(panels.DANTEW_PT_recover)
    assert "Stage 4 of 8" in notes and "About 40 s; 25 dB on test objects" in notes
    assert any(note.startswith("Fitting") for note in notes) and "dantew.cancel" in notes


def test_what_acts_is_shown(addon, standin, scene):
    settings = properties.settings_of(scene)
    for model, presets in MODEL_PRESETS.items():
        settings.irradiance, settings.preset = model, presets[0]
        notes = drawn(panels.DANTEW_PT_recover)
        assert [note.split()[1] for note in notes if note.startswith("preset ")] == list(presets)
        assert ("device" in notes) == (model == "field")
        components = [f"model_{component.key}" for component in COMPONENTS]
        assert [note for note in notes if note.startswith("model_")] == components * (model == "traced")
        assert bpy.ops.dantew.recover.poll()


def test_a_preset_of_the_other_model_is_an_error(addon, standin, scene):
    settings = properties.settings_of(scene)
    settings.irradiance, settings.preset = "traced", "paper"
    message = (
        "The preset Paper does not work with Traced Light. Choose another preset, or set Options > Light to"
    )
    assert any(note.startswith(message) for note in drawn(panels.DANTEW_PT_recover))
    assert not bpy.ops.dantew.recover.poll()
    with pytest.raises(RuntimeError, match="Paper does not work"):
        bpy.ops.dantew.recover()
    settings.irradiance = "field"
    assert bpy.ops.dantew.recover.poll()
