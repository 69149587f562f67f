"""The preferences: which Python runs the backend."""

from __future__ import annotations

import bpy
from bpy.props import StringProperty

from .. import layout
from ..bridge import interpreter, job
from ..operators.setup import DANTEW_OT_check_python, DANTEW_OT_make_environment, DANTEW_OT_stop_task

#: How a set-up task may end: a text and an icon.
ENDS = {
    "done": ("The backend works", "CHECKMARK"),
    "failed": ("The backend does not work:", "ERROR"),
    "stopped": ("Stopped", "INFO"),
}


class DANTEW_preferences(bpy.types.AddonPreferences):
    """Where the backend runs."""

    bl_idname = layout.ADDON

    python: StringProperty(
        name="Python",
        description="Interpreter with the backend's packages; leave empty to use the one made here",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.prop(self, "python")
        draw_backend(layout)


def draw_backend(layout: bpy.types.UILayout) -> None:
    """The state of the backend, and the buttons that set it up; in the preferences and the panel."""
    python = interpreter.backend_python()
    box = layout.box()
    if python is None:
        box.label(text="The backend is not set up yet", icon="INFO")
    else:
        box.label(text=f"Backend: {python}", icon="CHECKMARK")
    if job.setting_up():
        row = box.row()
        row.label(text=f"{job.task.title}...", icon="TIME")
        row.operator(DANTEW_OT_stop_task.bl_idname, icon="CANCEL")
        box.label(text=job.task.lines[-1][:80] if job.task.lines else "")
        return
    row = box.row()
    if interpreter.environment_folder() is not None:
        row.operator(DANTEW_OT_make_environment.bl_idname, icon="IMPORT")
        if not bpy.app.online_access:
            box.label(text="Needs Allow Online Access (Preferences > System)", icon="ERROR")
    row.operator(DANTEW_OT_check_python.bl_idname, icon="VIEWZOOM")
    if job.task is not None:
        text, icon = ENDS[job.task.state]
        box.label(text=text, icon=icon)
        column = box.column(align=True)
        for line in job.task.lines[-10:] if job.task.state != "stopped" else ():
            column.label(text=line[:100])


CLASSES = (DANTEW_preferences,)
