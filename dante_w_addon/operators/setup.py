"""Operators: make the backend's environment, check it, stop."""

from __future__ import annotations

import bpy

from .. import layout
from ..bridge import environment, interpreter, job


class DANTEW_OT_make_environment(bpy.types.Operator):
    """Make a Python environment for the backend in the extension's own folder and download its packages (about 1 GB)"""

    bl_idname = "dantew.make_environment"
    bl_label = "Set Up Backend"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if interpreter.made_environment() is None:
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
            commands = environment.commands(
                python, interpreter.made_environment(), layout.backend_folder() / "requirements.txt"
            )
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        venv = interpreter.made_environment()
        job.start_task(
            "Setting up the backend",
            [*commands, _doctor(str(environment.python_in(venv)))],
            lambda: (venv / interpreter.READY).write_text(
                "The backend runs in this environment.\n", encoding="utf-8"
            ),
        )
        return {"FINISHED"}


class DANTEW_OT_check_python(bpy.types.Operator):
    """Ask the backend which device, libraries and memory it would use"""

    bl_idname = "dantew.check_python"
    bl_label = "Check Backend"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if interpreter.backend_python() is None:
            cls.poll_message_set("No backend Python was found; set one up first")
            return False
        return not job.setting_up()

    def execute(self, context: bpy.types.Context) -> set[str]:
        job.start_task("Checking the backend", [_doctor(interpreter.backend_python())])
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
    return [python, "-I", "-X", "utf8", str(layout.launcher()), "doctor"]


CLASSES = (DANTEW_OT_make_environment, DANTEW_OT_check_python, DANTEW_OT_stop_task)
