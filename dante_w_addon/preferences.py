"""The backend's Python: found, typed, or made by one button."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
from bpy.props import StringProperty

from . import environment, job
from .paths import HERE, backend_folder, launcher, user_folder

#: Environment variable that names the backend's Python, for developers and render farms.
VARIABLE = "DANTEW_BACKEND_PYTHON"
#: File that says an environment was made to the end: half of one is none.
READY = "dante_w_ready.txt"
#: How a set-up task may end, in words and an icon.
ENDS = {
    "done": ("It works", "CHECKMARK"),
    "failed": ("It does not work:", "ERROR"),
    "stopped": ("Stopped", "INFO"),
}


def made_environment() -> Path | None:
    """Folder of the environment that the button makes: short, as Windows limits paths."""
    folder = user_folder()
    return folder / "venv" if folder is not None else None


def backend_python() -> str | None:
    """The interpreter to use: typed, named by the environment, made by the button, or the checkout's."""
    addons = bpy.context.preferences.addons  # batch.py runs under another name than the enabled extension
    enabled = (addon for addon in addons if addon.module == __package__ or addon.module.endswith(".dante_w"))
    typed = next((addon.preferences.python for addon in enabled if addon.preferences), "")
    made = made_environment()
    ready = made is not None and (made / READY).is_file()
    folders = [made if ready else None, None if user_folder() else HERE.parent / ".venv"]
    pythons = [str(environment.python_in(folder)) for folder in folders if folder is not None]
    choices = [bpy.path.abspath(typed), os.environ.get(VARIABLE, ""), *pythons]
    return next((choice for choice in choices if choice and Path(choice).is_file()), None)


class DANTEW_preferences(bpy.types.AddonPreferences):
    """Where the backend runs."""

    bl_idname = __package__

    python: StringProperty(
        name="Python",
        description="Interpreter with the backend's packages; leave empty to use the one made here",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.prop(self, "python")
        draw_backend(layout)


class DANTEW_OT_make_environment(bpy.types.Operator):
    """Make a Python environment for the backend in the extension's own folder and download its packages (about 1 GB)"""

    bl_idname = "dantew.make_environment"
    bl_label = "Set Up Backend"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if made_environment() is None:
            cls.poll_message_set("In a checkout, dev.py makes the environment")
        elif not bpy.app.online_access:
            cls.poll_message_set("Turn on Preferences > System > Network > Allow Online Access first")
        elif job.setting_up():
            cls.poll_message_set("Already at work")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        python = environment.base_python()
        if python is None:
            self.report(
                {"ERROR"}, "No Python 3.11 or newer that makes environments was found (Debian: python3-venv)"
            )
            return {"CANCELLED"}
        try:
            commands = environment.commands(python, made_environment(), backend_folder() / "requirements.txt")
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        venv = made_environment()
        job.start_task(
            "Setting up the backend",
            [*commands, _doctor(str(environment.python_in(venv)))],
            lambda: (venv / READY).write_text("The backend runs in this environment.\n", encoding="utf-8"),
        )
        return {"FINISHED"}


class DANTEW_OT_check_python(bpy.types.Operator):
    """Ask the backend which device, libraries and memory it would use"""

    bl_idname = "dantew.check_python"
    bl_label = "Check Backend"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if backend_python() is None:
            cls.poll_message_set("No backend Python was found; set one up first")
            return False
        return not job.setting_up()

    def execute(self, context: bpy.types.Context) -> set[str]:
        job.start_task("Checking the backend", [_doctor(backend_python())])
        return {"FINISHED"}


class DANTEW_OT_stop_task(bpy.types.Operator):
    """Stop setting up"""

    bl_idname = "dantew.stop_task"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return job.setting_up()

    def execute(self, context: bpy.types.Context) -> set[str]:
        if job.task.process is not None:
            job.task.process.cancel()
        return {"FINISHED"}


def _doctor(python: str) -> list[str]:
    return [python, "-I", "-X", "utf8", str(launcher()), "doctor"]


def draw_backend(layout: bpy.types.UILayout) -> None:
    """The state of the backend, and the buttons that set it up; in the preferences and the panel."""
    python = backend_python()
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
    if made_environment() is not None:
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


CLASSES = (
    DANTEW_preferences,
    DANTEW_OT_make_environment,
    DANTEW_OT_check_python,
    DANTEW_OT_stop_task,
)
