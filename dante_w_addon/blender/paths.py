"""Names and folders of what a run writes."""

from __future__ import annotations

import re
from pathlib import Path

import bpy


def file_name(text: str) -> str:
    """`text` made safe as a file name on every system."""
    return re.sub(r'[\x00-\x1f<>:"/\\|?*]', "_", text).strip(". ") or "unnamed"


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
