"""The scene folders that a benchmark runs on."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path


def scenes_in(folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """The scene folders with test views below `folder`, all or those of the given names; ends the program without any."""
    scenes = sorted(file.parent for file in folder.glob("*/transforms_test.json"))
    if names:
        scenes = [scene for scene in scenes if scene.name in names]
    if not scenes:
        sys.exit(f"{folder}: no such objects here; name a folder of scene folders.")
    return scenes
