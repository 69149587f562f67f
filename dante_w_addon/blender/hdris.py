"""The environments to relight under: those that ship with Blender (CC0), or a file of the user's."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import bpy

SUFFIXES = (".exr", ".hdr")
OWN = "OWN"


@cache
def presets() -> dict[str, Path]:
    """Name and file of each HDRI that ships with Blender."""
    folder = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
    return {path.stem: path for path in sorted(folder.glob("*")) if path.suffix.lower() in SUFFIXES}


def title(stem: str) -> str:
    """A file's name as people read it."""
    return stem.replace("_", " ").title()


def enum_items() -> list[tuple[str, str, str]]:
    """Menu entries."""
    items = [(name, title(name), f"{name}, ships with Blender") for name in presets()]
    return [*items, (OWN, "Own File", "Any equirectangular .hdr or .exr file")]


def file_of(choice: str, own_file: str) -> Path | None:
    """The HDRI file of a menu entry or a preset's name; None where it does not exist."""
    path = Path(bpy.path.abspath(own_file)) if choice == OWN else presets().get(choice)
    return path if path is not None and path.is_file() and path.suffix.lower() in SUFFIXES else None
