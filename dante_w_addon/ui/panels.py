"""The sidebar tab "DANTE-W"."""

from __future__ import annotations

import textwrap

import bpy

from ..blender import hdris, known_colours, material, properties, survey
from ..bridge import interpreter, job
from ..bridge.process import decisions
from ..operators import relight
from . import preferences

MAX_PROBLEMS = 4


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "DANTE-W"


class DANTEW_PT_source(_Panel, bpy.types.Panel):
    bl_label = "Source"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.of(context.scene)
        obj = survey.active_mesh(context)
        found = survey.take(context.scene, obj)
        column = layout.column(align=True)
        if obj is None:
            column.label(text="Select the mesh to texture", icon="OUTLINER_OB_MESH")
        else:
            column.label(text=f"{obj.name}: {len(obj.data.polygons):,} faces", icon="OUTLINER_OB_MESH")
        column.label(text=f"{found.photos} of {found.cameras} cameras have photos", icon="OUTLINER_OB_CAMERA")
        for problem in found.problems[:MAX_PROBLEMS]:
            _sentence(context, layout, problem, "ERROR")
        if len(found.problems) > MAX_PROBLEMS:
            layout.label(text=f"... and {len(found.problems) - MAX_PROBLEMS} more")
        if found.overlay_off:
            _sentence(context, layout, "The render has another shape than the camera's photo.", "INFO")
            layout.operator("dantew.match_render", icon="CAMERA_DATA")
        layout.operator("dantew.import_scene", icon="IMPORT")
        column = _properties(layout)
        column.prop(settings, "prior_folder", placeholder="Optional")


class DANTEW_PT_recover(_Panel, bpy.types.Panel):
    bl_label = "Recover"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.of(context.scene)
        if interpreter.backend_python() is None or job.setting_up():
            preferences.draw_backend(layout)
        column = _properties(layout)
        column.enabled = not job.recovering()
        column.prop(settings, "preset")
        column.prop(settings, "texture_size")
        column.prop(settings, "device")
        header, body = layout.panel("DANTEW_options", default_closed=True)
        header.label(text="Options")
        if body is not None:
            column = _properties(body)
            column.enabled = not job.recovering()
            column.prop(settings, "file_format")
            column.prop(settings, "storage")
            column.prop(settings, "output_folder", placeholder="Beside the .blend")
            column.prop(settings, "unwrap")
            column.prop(settings, "irradiance")
            if settings.irradiance == "traced":
                _draw_parts(body, settings)
        _draw_known_colours(context, layout)
        if job.recovering():
            _draw_progress(context, layout, job.recovery)
            return
        row = layout.row()
        row.scale_y = 1.6
        row.operator("dantew.recover", icon="SHADING_TEXTURE")
        if job.recovery is not None and job.recovery.progress.message:
            failed = job.recovery.progress.state == "failed"
            _sentence(context, layout, job.recovery.progress.message, "ERROR" if failed else "INFO")


class DANTEW_PT_result(_Panel, bpy.types.Panel):
    bl_label = "Result"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.layout, survey.active_mesh(context)
        shown = material.shown(obj) if obj is not None else None
        if shown is None:
            layout.label(text="No albedo recovered yet", icon="INFO")
            return
        row = layout.row(align=True)
        row.scale_y = 1.3
        for which in ("ORIGINAL", "ALBEDO"):
            row.operator("dantew.show", text=which.title(), depress=shown == which).which = which
        report = material.report_of(obj)
        column = layout.column(align=True)
        for name, value in facts(report):
            split = column.split(factor=0.55)
            split.label(text=name)
            split.label(text=value)
        _draw_plan(context, layout, decisions(report.get("plan")))
        layout.operator("dantew.open_report", icon="TEXT")


class DANTEW_PT_relight(_Panel, bpy.types.Panel):
    bl_label = "Relight"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.of(context.scene)
        column = _properties(layout)
        column.prop(settings, "hdri")
        if settings.hdri == hdris.OWN:
            column.prop(settings, "hdri_file")
        column.prop(settings, "rotation")
        column.prop(settings, "strength")
        column.prop(settings, "samples")
        running = relight.active
        if running is not None:
            done, total = len(running.files), len(running.lights)
            layout.progress(factor=(done + 0.5) / total, text=f"Rendering {done + 1} of {total}")
        else:
            row = layout.row(align=True)
            row.scale_y = 1.3
            row.operator("dantew.relight", text="Preview", icon="RENDER_STILL").every = False
            row.operator("dantew.relight", text="Contact Sheet", icon="MESH_GRID").every = True
            if relight.last_message:
                _sentence(context, layout, relight.last_message, "INFO")
        image = relight.latest_image()
        if image is not None and image.preview is not None:
            layout.operator("dantew.open_image", text="Open Picture", icon="IMAGE_DATA").name = image.name
            units = context.region.width / (24.0 * context.preferences.system.ui_scale)
            layout.template_icon(icon_value=image.preview.icon_id, scale=min(units, 11.0))


def facts(report: dict) -> list[tuple[str, str]]:
    """Lines of the Result panel from a report; what the report does not say is left out."""
    lines = []
    if isinstance(report.get("held_out_psnr"), (int, float)):
        lines.append(("Held-out photos", f"{report['held_out_psnr']:.1f} dB"))
    if isinstance(report.get("coverage"), (int, float)):
        lines.append(("Seen by a photo", f"{report['coverage']:.1%}"))
    if isinstance(report.get("texture_size"), int):
        lines.append(("Texture", f"{report['texture_size']} x {report['texture_size']}"))
    if isinstance(report.get("seconds"), dict):
        took = duration(sum(report["seconds"].values()))
        seconds = _total(report.get("expected"))
        if seconds is None:
            lines.append(("Took", took))
        else:
            lines.append(("Took (expected)", f"{took} ({duration(seconds)})"))
    return lines


def expectation(expected: dict) -> str:
    """The run's expectation in one line: its whole time and what the preset reached elsewhere; empty if unsaid."""
    seconds = _total(expected)
    if seconds is None:
        return ""
    reached = expected.get("albedo_psnr_after_gain")
    if not (isinstance(reached, dict) and isinstance(reached.get("mean"), (int, float))):
        return f"About {duration(seconds)}"
    return f"About {duration(seconds)}, {reached['mean']:.0f} dB on test objects"


def _total(expected: object) -> float | None:
    seconds = expected.get("total_seconds") if isinstance(expected, dict) else None
    return seconds if isinstance(seconds, (int, float)) else None


def duration(seconds: float) -> str:
    """Seconds as people say them: 45 s, 3 min, 1 h 20 min."""
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _draw_known_colours(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    obj = survey.active_mesh(context)
    spots = known_colours.of(obj) if obj is not None else ()
    header, body = layout.panel("DANTEW_known_colours", default_closed=True)
    header.label(text=f"Known Colours ({len(spots)})" if spots else "Known Colours")
    if body is None:
        return
    column = body.column(align=True)
    column.enabled = not job.recovering()
    for index, spot in enumerate(spots):
        split = column.split(factor=0.1)
        split.label(text=str(index + 1))  # as the ring in the 3D view
        row = split.row(align=True)
        row.prop(spot, "grey", toggle=True)
        colour = row.row(align=True)
        colour.enabled = not spot.grey
        colour.prop(spot, "colour", text="")
        row.operator("dantew.remove_known_colour", text="", icon="X").index = index
    column.operator("dantew.pick_known_colour", text="Pick on Mesh", icon="EYEDROPPER")


def _draw_parts(layout: bpy.types.UILayout, settings: properties.DANTEW_PG_settings) -> None:
    header, body = layout.panel("DANTEW_parts", default_closed=True)
    header.label(text="What to Model")
    if body is not None:
        column = _properties(body)
        column.enabled = not job.recovering()
        for part in properties.PARTS:
            column.prop(settings, f"model_{part}")


def _draw_plan(context: bpy.types.Context, layout: bpy.types.UILayout, plan: list[dict[str, str]]) -> None:
    if not plan:
        return
    header, body = layout.panel("DANTEW_plan", default_closed=True)
    header.label(text="Plan")
    if body is not None:
        for line in plan:
            _sentence(context, body, f"{line['what'].capitalize()}: {line['choice']}", "DOT")
            _sentence(context, body, line["reason"], "BLANK1")


def _draw_progress(context: bpy.types.Context, layout: bpy.types.UILayout, recovery: job.Recovery) -> None:
    progress = recovery.progress
    number, stages = progress.place
    name = progress.stage.capitalize()
    layout.progress(
        factor=progress.fraction, text=f"{name}  {progress.fraction:.0%}" if progress.total else name
    )
    column = layout.column(align=True)
    expected = expectation(progress.expected)
    if expected:
        column.label(text=expected, icon="INFO")
    if number:
        column.label(text=f"Stage {number} of {stages}")
    if progress.seconds_left is not None:
        column.label(text=f"{duration(progress.seconds_left)} left", icon="TIME")
    if progress.loss is not None:
        column.label(text=f"Loss {progress.loss:.4f}", icon="GRAPH")
    _draw_plan(context, layout, progress.plan)
    if progress.silent:
        text = f"Nothing heard from the backend for {duration(progress.silent)}; it may be stuck."
        _sentence(context, layout, text, "ERROR")
    stopping = recovery.process.cancelled
    row = layout.row()
    row.scale_y = 1.3
    row.enabled = not stopping
    row.operator("dantew.cancel", text="Stopping..." if stopping else "Cancel", icon="CANCEL")


def _properties(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    return column


def _sentence(context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """A text of any length, wrapped to the sidebar."""
    scale = context.preferences.system.ui_scale
    width = max(int((context.region.width - 60 * scale) / (6.5 * scale)), 16)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for paragraph in text.splitlines():
        for line in textwrap.wrap(paragraph, width, break_long_words=True) or [""]:
            column.label(text=line, icon=icon)
            icon = "BLANK1"


CLASSES = (DANTEW_PT_source, DANTEW_PT_recover, DANTEW_PT_result, DANTEW_PT_relight)
