"""Which Python runs the backend: typed, named by a variable, made by the button, or the checkout's."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .. import layout
from . import environment

#: Environment variable that names the backend's Python, for developers and render farms.
VARIABLE = "DANTEW_BACKEND_PYTHON"
#: File that says an environment was made to the end: half of one is none.
READY = "dante_w_ready.txt"


def made_environment() -> Path | None:
    """Folder of the environment that the button makes: short, as Windows limits paths."""
    folder = layout.user_folder()
    return folder / "venv" if folder is not None else None


def backend_python() -> str | None:
    """The interpreter to use: typed, named by the environment, made by the button, or the checkout's."""
    addons = bpy.context.preferences.addons  # batch.py runs under another name than the enabled extension
    enabled = (addon for addon in addons if addon.module == layout.ADDON or addon.module.endswith(".dante_w"))
    typed = next((addon.preferences.python for addon in enabled if addon.preferences), "")
    made = made_environment()
    ready = made is not None and (made / READY).is_file()
    folders = [made if ready else None, None if layout.user_folder() else layout.HERE.parent / ".venv"]
    pythons = [str(environment.python_in(folder)) for folder in folders if folder is not None]
    choices = [bpy.path.abspath(typed), os.environ.get(VARIABLE, ""), *pythons]
    return next((choice for choice in choices if choice and Path(choice).is_file()), None)
