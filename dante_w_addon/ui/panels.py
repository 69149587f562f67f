"""The sidebar tab "DANTE-W"."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import hdris, known_colours, material, properties, survey
from ..bridge import interpreter, job
from ..contract.report import summary
from ..contract.text import duration
from ..contract.vocabulary import COMPONENTS, MODEL_PRESETS
from ..operators import relight
from . import preferences
from .elements import draw_plan, draw_progress, draw_sentence, property_column

MAX_PROBLEMS = 4


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "DANTE-W"


class DANTEW_PT_source(_Panel, bpy.types.Panel):
    bl_label = "Source"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.settings_of(context.scene)
        obj = survey.active_mesh(context)
        state = survey.examine(context.scene, obj)
        column = layout.column(align=True)
        if obj is None:
            column.label(text="Select the mesh to texture", icon="OUTLINER_OB_MESH")
        else:
            column.label(text=f"{obj.name}: {len(obj.data.polygons):,} faces", icon="OUTLINER_OB_MESH")
        column.label(text=f"{state.photos} of {state.cameras} cameras have photos", icon="OUTLINER_OB_CAMERA")
        for problem in state.problems[:MAX_PROBLEMS]:
            draw_sentence(context, layout, problem, "ERROR")
        if len(state.problems) > MAX_PROBLEMS:
            layout.label(text=f"... and {len(state.problems) - MAX_PROBLEMS} more")
        if state.overlay_off:
            draw_sentence(
                context,
                layout,
                "The render's aspect ratio is not the photo's, so photo and mesh do not line up.",
                "INFO",
            )
            layout.operator("dantew.match_render", icon="CAMERA_DATA")
        layout.operator("dantew.import_scene", icon="IMPORT")
        column = property_column(layout)
        column.prop(settings, "prior_folder", placeholder="Optional")


class DANTEW_PT_recover(_Panel, bpy.types.Panel):
    bl_label = "Recover"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.settings_of(context.scene)
        if interpreter.backend_python() is None or job.setting_up():
            preferences.draw_backend(layout)
        _draw_options(context, layout, settings)
        _draw_known_colours(context, layout)
        if job.recovering():
            draw_progress(context, layout, job.recovery)
            return
        row = layout.row()
        row.scale_y = 1.6
        row.operator("dantew.recover", icon="SHADING_TEXTURE")
        if job.recovery is not None and job.recovery.progress.message:
            icon = "ERROR" if job.recovery.state == "failed" else "INFO"
            draw_sentence(context, layout, job.recovery.progress.message, icon)


class DANTEW_PT_result(_Panel, bpy.types.Panel):
    bl_label = "Result"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.layout, survey.active_mesh(context)
        display = material.display_of(obj) if obj is not None else None
        if display is None:
            layout.label(text="No albedo recovered yet", icon="INFO")
            return
        row = layout.row(align=True)
        row.scale_y = 1.3
        for which in ("ORIGINAL", "ALBEDO"):
            row.operator("dantew.show", text=which.title(), depress=display == which).which = which
        report = material.report_of(obj)
        column = layout.column(align=True)
        for name, value in facts(report):
            split = column.split(factor=0.55)
            split.label(text=name)
            split.label(text=value)
        draw_plan(context, layout, summary(report).plan)
        layout.operator("dantew.open_report", icon="TEXT")


class DANTEW_PT_relight(_Panel, bpy.types.Panel):
    bl_label = "Relight"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, properties.settings_of(context.scene)
        column = property_column(layout)
        column.prop(settings, "hdri")
        if settings.hdri == hdris.OWN:
            column.prop(settings, "hdri_file")
        column.prop(settings, "rotation")
        column.prop(settings, "strength")
        column.prop(settings, "samples")
        relighting = relight.active
        if relighting is not None:
            total = len(relighting.lights)
            index = min(len(relighting.files), total - 1)
            row = layout.row(align=True)
            row.progress(factor=(index + 0.5) / total, text=f"Rendering {index + 1} of {total}")
            row.operator("dantew.cancel_relight", text="", icon="X")
        else:
            row = layout.row(align=True)
            row.scale_y = 1.3
            row.operator("dantew.relight", text="Preview", icon="RENDER_STILL").every = False
            row.operator("dantew.relight", text="Contact Sheet", icon="MESH_GRID").every = True
            if relight.last_message:
                draw_sentence(context, layout, relight.last_message, "INFO")
        image = relight.latest_image()
        if image is not None and image.preview is not None:
            layout.operator("dantew.open_image", text="Open Picture", icon="IMAGE_DATA").name = image.name
            units = context.region.width / (24.0 * context.preferences.system.ui_scale)
            layout.template_icon(icon_value=image.preview.icon_id, scale=min(units, 11.0))


def facts(report: dict[str, Any]) -> list[tuple[str, str]]:
    """Lines of the Result panel from a report; what the report does not have is left out."""
    result, lines = summary(report), []
    if result.held_out_psnr is not None:
        lines.append(("Held-out photos", f"{result.held_out_psnr:.1f} dB"))
    if result.coverage is not None:
        lines.append(("Seen by a photo", f"{result.coverage:.1%}"))
    if result.texture_size is not None:
        lines.append(("Texture", f"{result.texture_size} x {result.texture_size}"))
    if result.seconds is not None and result.expected is not None:
        lines.append(
            ("Time (expected)", f"{duration(result.seconds)} ({duration(result.expected.total_seconds)})")
        )
    elif result.seconds is not None:
        lines.append(("Time", duration(result.seconds)))
    return lines


def _draw_options(
    context: bpy.types.Context, layout: bpy.types.UILayout, settings: properties.DANTEW_PG_settings
) -> None:
    presets = layout.row(align=True)
    presets.enabled = not job.recovering()
    for preset in MODEL_PRESETS[settings.irradiance]:
        presets.prop_enum(settings, "preset", preset)
    problem = properties.preset_problem(settings)
    if problem:
        draw_sentence(context, layout, problem, "ERROR")
    column = property_column(layout)
    column.enabled = not job.recovering()
    column.prop(settings, "texture_size")
    if settings.irradiance == "field":
        column.prop(settings, "device")
    header, body = layout.panel("DANTEW_options", default_closed=True)
    header.label(text="Options")
    if body is not None:
        column = property_column(body)
        column.enabled = not job.recovering()
        column.prop(settings, "file_format")
        column.prop(settings, "storage")
        column.prop(settings, "output_folder", placeholder="Beside the .blend")
        column.prop(settings, "unwrap")
        column.prop(settings, "irradiance")
        if settings.irradiance == "traced":
            _draw_components(body, settings)


def _draw_known_colours(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    obj = survey.active_mesh(context)
    spots = known_colours.spots_of(obj) if obj is not None else ()
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


def _draw_components(layout: bpy.types.UILayout, settings: properties.DANTEW_PG_settings) -> None:
    header, body = layout.panel("DANTEW_parts", default_closed=True)
    header.label(text="What to Model")
    if body is not None:
        column = property_column(body)
        column.enabled = not job.recovering()
        for component in COMPONENTS:
            column.prop(settings, f"model_{component.key}")


CLASSES = (DANTEW_PT_source, DANTEW_PT_recover, DANTEW_PT_result, DANTEW_PT_relight)
