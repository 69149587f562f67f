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

PACKAGE = "dante_w_addon"


def load() -> ModuleType:
    """Import the package this file lies in, whatever its folder is called."""
    if PACKAGE not in sys.modules:
        here = Path(__file__).resolve().parent
        spec = importlib.util.spec_from_file_location(
            PACKAGE, here / "__init__.py", submodule_search_locations=[str(here)]
        )
        package = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = package
        spec.loader.exec_module(package)
    return importlib.import_module(f"{PACKAGE}.headless")


def arguments() -> list[str]:
    """What is meant for us: after `--` where Blender was called, else all."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return [] if "--python" in sys.argv or "-P" in sys.argv else sys.argv[1:]


if __name__ == "__main__":
    import bpy  # noqa: F401  the bpy module must be there before the package

    sys.exit(load().main(arguments()))
