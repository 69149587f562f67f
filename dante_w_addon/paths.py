"""Where things are: the backend's sources, the contract with the backend, folders for runs.

The add-on lives in two layouts, and this is the one module that knows both: in the repository the
backend lies beside this package, in the installed zip it lies inside it.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

import bpy

HERE = Path(__file__).resolve().parent


def backend_folder() -> Path:
    """Folder with `launch.py`, `requirements.txt` and the package `dante_w`."""
    inside = HERE / "backend"
    return inside if (inside / "launch.py").is_file() else HERE.parent / "backend"


def launcher() -> Path:
    """The script that the backend's Python runs."""
    return backend_folder() / "launch.py"


def _load_contract() -> None:
    """Make the backend's package `contract` importable as `.contract`: one definition for both sides of the wall."""
    name, folder = f"{__package__}.contract", backend_folder() / "dante_w" / "contract"
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)


_load_contract()
from .contract import scene_folder  # noqa: E402, F401


def file_name(text: str) -> str:
    """`text` made safe as a file name on every system."""
    return re.sub(r'[\x00-\x1f<>:"/\\|?*]', "_", text).strip(". ") or "unnamed"


def user_folder() -> Path | None:
    """The extension's own folder, or None where the add-on runs from a checkout."""
    if __package__.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(__package__, create=True))
    if (HERE / "backend").is_dir():  # installed, but run by batch.py under another name
        return HERE.parent.parent / ".user" / HERE.parent.name / HERE.name
    return None


def run_folder(setting: str, object_name: str) -> Path:
    """Folder of one object's scene and result: beside the .blend by default, temporary while it is unsaved."""
    if bpy.data.filepath:
        base = Path(bpy.path.abspath(setting or "//dante_w"))
    elif setting and not setting.startswith("//"):
        base = Path(setting)
    else:
        base = Path(bpy.app.tempdir) / "dante_w"
    return base / file_name(object_name)


def is_temporary(folder: Path) -> bool:
    """Whether Blender deletes `folder` when it quits."""
    return Path(folder).resolve().is_relative_to(Path(bpy.app.tempdir).resolve())
