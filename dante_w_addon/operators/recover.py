"""Operators: recover, cancel, switch what the object shows, and open the report."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import EnumProperty

from ..blender import known_colours, material, properties, survey
from ..blender.paths import is_temporary, run_folder
from ..bridge import export, interpreter, job
from ..contract.command import Request
from ..contract.errors import BadInput
from . import windows


class DANTEW_OT_recover(bpy.types.Operator):
    """Recover the albedo texture of the active mesh from its photos. You can go on working meanwhile"""

    bl_idname = "dantew.recover"
    bl_label = "Recover Albedo"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        if job.recovering():
            cls.poll_message_set("A recovery is running")
        elif obj is None:
            cls.poll_message_set("Make the mesh the active object")
        elif interpreter.backend_python() is None:
            cls.poll_message_set("Set the backend up first")
        else:
            preset_problem = properties.preset_problem(properties.settings_of(context.scene))
            problems = [*filter(None, [preset_problem]), *survey.examine(context.scene, obj).problems]
            if not problems:
                return True
            cls.poll_message_set(problems[0])
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings, obj = properties.settings_of(context.scene), survey.active_mesh(context)
        folder = run_folder(settings.output_folder, obj.name)
        request = _request(settings, obj, folder)
        # Images in a folder that Blender deletes when it quits would be lost.
        pack = settings.storage == "PACK" or is_temporary(folder)
        try:
            export.export_scene(context.scene, obj, context.evaluated_depsgraph_get(), request.scene)
            command = interpreter.command(interpreter.backend_python(), request.arguments())
            job.start_recovery(command, obj, request.out, pack)
        except (BadInput, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _request(settings: properties.DANTEW_PG_settings, obj: bpy.types.Object, folder: Path) -> Request:
    """What the panel's settings ask of the backend; scene and result go into `folder`."""
    traced = settings.irradiance == "traced"
    components, left_out = properties.component_choices(settings) if traced else ((), ())
    return Request(
        scene=folder / "scene",
        out=folder / "result",
        model=settings.irradiance,
        preset=settings.preset,
        texture_size=0 if settings.texture_size == properties.AUTOMATIC else int(settings.texture_size),
        file_format=settings.file_format,
        device=settings.device,
        priors=Path(bpy.path.abspath(settings.prior_folder)) if settings.prior_folder else None,
        unwrap=settings.unwrap,
        known=known_colours.as_words(obj),
        components=components,
        left_out=left_out,
    )


class DANTEW_OT_cancel(bpy.types.Operator):
    """Stop the recovery; the scene stays as it was"""

    bl_idname = "dantew.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return job.recovering()

    def execute(self, context: bpy.types.Context) -> set[str]:
        job.recovery.process.cancel()
        return {"FINISHED"}


class DANTEW_OT_show(bpy.types.Operator):
    """Switch the active object between its original materials and the recovered albedo"""

    bl_idname = "dantew.show"
    bl_label = "Show"
    bl_options = {"REGISTER", "UNDO"}

    which: EnumProperty(items=(("ORIGINAL", "Original", ""), ("ALBEDO", "Albedo", "")))

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        if obj is None or material.display_of(obj) is None:
            cls.poll_message_set("The active object has no recovered albedo")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        material.show(survey.active_mesh(context), self.which)
        return {"FINISHED"}


class DANTEW_OT_open_report(bpy.types.Operator):
    """Open the report of the active object's albedo: settings, versions, times and quality"""

    bl_idname = "dantew.open_report"
    bl_label = "Open Report"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        return obj is not None and material.REPORT_TEXT in obj

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = survey.active_mesh(context)
        name = f"{obj.name} report.json"
        text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
        text.clear()
        text.write(obj[material.REPORT_TEXT])
        text.cursor_set(0)
        windows.open_editor(context, "TEXT_EDITOR", text)
        return {"FINISHED"}


CLASSES = (DANTEW_OT_recover, DANTEW_OT_cancel, DANTEW_OT_show, DANTEW_OT_open_report)
