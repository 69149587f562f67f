"""Run the add-on without a window and without installing it.

    blender -b scene.blend --python dante_w_addon/batch.py -- --preset standard --out DIR
    python dante_w_addon/batch.py scene.blend --preset standard --out DIR     # Python with the bpy module

It works from the repository and from inside the installed extension; the exit codes are the backend's.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import bpy

PACKAGE = "dante_w_addon"


def load() -> ModuleType:
    """Import the package this file lies in, whatever its folder is called; returns its module `headless`."""
    if PACKAGE not in sys.modules:
        folder = Path(__file__).resolve().parent
        spec = importlib.util.spec_from_file_location(
            PACKAGE, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )
        package = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = package
        spec.loader.exec_module(package)
    return importlib.import_module(f"{PACKAGE}.bridge.headless")


def arguments() -> list[str]:
    """What is meant for us: after `--`; without one, all in a Python, nothing in a Blender."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return [] if bpy.app.binary_path else sys.argv[1:]


if __name__ == "__main__":
    sys.exit(load().main(arguments()))
