"""Which Python runs the backend: typed, named by a variable, made by the button, or the checkout's."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import bpy

from .. import layout
from . import environment

#: Environment variable that names the backend's Python, for developers and render farms.
VARIABLE = "DANTEW_BACKEND_PYTHON"
#: File in an environment that is complete: half of one is none.
READY = "dante_w_ready.txt"


def environment_folder() -> Path | None:
    """Folder of the environment that *Set Up Backend* makes, None in a checkout. Short, as Windows limits paths."""
    folder = layout.user_folder()
    return folder / "venv" if folder is not None else None


def mark_ready(folder: Path) -> None:
    """Note that the environment in `folder` is complete."""
    (folder / READY).write_text("The backend runs in this environment.\n", encoding="utf-8")


def command(python: str, arguments: Sequence[str]) -> list[str]:
    """The command line that runs the backend in the interpreter `python`, apart from the user's own Python settings."""
    return [python, "-I", "-X", "utf8", str(layout.launcher()), *arguments]


def backend_python() -> str | None:
    """The interpreter to use, None where there is none: the first that exists of the preference, the one that VARIABLE
    names, and that of the extension's own environment or the checkout's."""
    choices = [bpy.path.abspath(_preference()), os.environ.get(VARIABLE, "")]
    folder = environment_folder()
    if folder is None:
        choices.append(str(environment.python_in(layout.FOLDER.parent / ".venv")))
    elif (folder / READY).is_file():
        choices.append(str(environment.python_in(folder)))
    return next((choice for choice in choices if choice and Path(choice).is_file()), None)


def _preference() -> str:
    """What the user typed in the preferences. batch.py runs under another name than the extension that has them."""
    for addon in bpy.context.preferences.addons:
        if addon.preferences and (addon.module == layout.ADDON or addon.module.endswith(".dante_w")):
            return addon.preferences.python
    return ""
