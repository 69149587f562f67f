"""Operators: make the backend's environment, check the backend, stop either."""

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
        if interpreter.environment_folder() is None:
            cls.poll_message_set("In a checkout, dev.py makes the environment")
        elif not bpy.app.online_access:
            cls.poll_message_set("Turn on Preferences > System > Network > Allow Online Access first")
        elif job.setting_up():
            cls.poll_message_set("A set-up is running")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        python = environment.base_python()
        if python is None:
            self.report(
                {"ERROR"},
                "No Python 3.11 or newer that can make environments was found; on Debian install python3-venv",
            )
            return {"CANCELLED"}
        folder = interpreter.environment_folder()
        try:
            commands = environment.commands(python, folder, layout.backend_folder() / "requirements.txt")
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        commands.append(interpreter.command(str(environment.python_in(folder)), ["doctor"]))
        job.start_task("Setting up the backend", commands, lambda: interpreter.mark_ready(folder))
        return {"FINISHED"}


class DANTEW_OT_check_python(bpy.types.Operator):
    """Show which device, libraries and memory the backend would use"""

    bl_idname = "dantew.check_python"
    bl_label = "Check Backend"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if interpreter.backend_python() is None:
            cls.poll_message_set("No backend Python was found; set one up first")
            return False
        return not job.setting_up()

    def execute(self, context: bpy.types.Context) -> set[str]:
        job.start_task(
            "Checking the backend", [interpreter.command(interpreter.backend_python(), ["doctor"])]
        )
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


CLASSES = (DANTEW_OT_make_environment, DANTEW_OT_check_python, DANTEW_OT_stop_task)
