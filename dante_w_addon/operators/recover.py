"""Operators: recover, cancel, switch what the object shows, and open the report."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..blender import known_colours, material, properties, survey
from ..blender.paths import is_temporary, run_folder
from ..bridge import export, interpreter, job, result
from ..contract import scene_folder
from . import windows


class DANTEW_OT_recover(bpy.types.Operator):
    """Recover the albedo texture of the active mesh from its photos; Blender stays usable meanwhile"""

    bl_idname = "dantew.recover"
    bl_label = "Recover Albedo"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        if job.recovering():
            cls.poll_message_set("A recovery is running")
        elif obj is None:
            cls.poll_message_set("Make the mesh to texture the active object")
        elif interpreter.backend_python() is None:
            cls.poll_message_set("Set the backend up first")
        else:
            problems = survey.take(context.scene, obj).problems
            if not problems:
                return True
            cls.poll_message_set(problems[0])
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings, obj = properties.of(context.scene), survey.active_mesh(context)
        folder = run_folder(settings.output_folder, obj.name)
        size = 0 if settings.texture_size == "AUTO" else int(settings.texture_size)
        try:
            depsgraph = context.evaluated_depsgraph_get()
            export.export_scene(context.scene, obj, depsgraph, folder / "scene")
            command = result.recover_command(
                interpreter.backend_python(),
                folder / "scene",
                folder / "result",
                preset=settings.preset,
                texture_size=size,
                device=settings.device,
                file_format=settings.file_format,
                priors=bpy.path.abspath(settings.prior_folder) if settings.prior_folder else "",
                unwrap_mesh=settings.unwrap,
                known=known_colours.words(obj),
                irradiance=settings.irradiance,
                **properties.parts(settings),
            )
            # Images in a folder that goes with Blender's end would be lost.
            pack = settings.storage == "PACK" or is_temporary(folder)
            job.start_recovery(command, obj, folder / "result", pack)
        except (scene_folder.BadInput, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


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
        if obj is None or material.shown(obj) is None:
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
        return obj is not None and material.REPORT in obj

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = survey.active_mesh(context)
        name = f"{obj.name} report.json"
        text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
        text.clear()
        text.write(obj[material.REPORT])
        text.cursor_set(0)
        windows.open_editor(context, "TEXT_EDITOR", text)
        return {"FINISHED"}


CLASSES = (DANTEW_OT_recover, DANTEW_OT_cancel, DANTEW_OT_show, DANTEW_OT_open_report)
