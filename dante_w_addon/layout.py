"""Where the add-on's own files are.

The add-on lives in two layouts, and this is the one module that knows both: in the repository the backend's
sources lie beside this package, in the installed zip they lie inside it.
"""

from __future__ import annotations

from pathlib import Path

import bpy

#: Name under which Blender knows the add-on: `dante_w_addon`, or `bl_ext.REPOSITORY.dante_w` once installed.
ADDON = __package__
FOLDER = Path(__file__).resolve().parent


def backend_folder() -> Path:
    """Folder with `launch.py`, `requirements.txt` and the package `dante_w`."""
    in_extension = FOLDER / "backend"
    return in_extension if (in_extension / "launch.py").is_file() else FOLDER.parent / "backend"


def launcher() -> Path:
    """The script that the backend's Python runs."""
    return backend_folder() / "launch.py"


def user_folder() -> Path | None:
    """The folder in which the extension may write, or None where the add-on runs from a checkout."""
    if ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON, create=True))
    if (FOLDER / "backend").is_dir():  # installed, but run by batch.py under another name
        return FOLDER.parent.parent / ".user" / FOLDER.parent.name / FOLDER.name
    return None
