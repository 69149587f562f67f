"""The add-on's rooms, read off the sources: imports point downwards, and no file needs itself."""

import ast
from graphlib import CycleError, TopologicalSorter

import pytest
from conftest import ROOT

ADDON = ROOT / "dante_w_addon"
#: From the top; a room may import from itself and from what stands after it.
ROOMS = ("", "ui", "operators", "bridge", "blender", "contract", "layout")


def imports():
    """Module of the add-on -> modules of the add-on that it imports, as paths from its root."""
    files = {path.relative_to(ADDON).with_suffix("").as_posix(): path for path in ADDON.rglob("*.py")}
    found = {}
    for name, path in files.items():
        folder = name.split("/")[:-1]
        found[name] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = [
                    *folder[: len(folder) + 1 - node.level],
                    *filter(None, (node.module or "").split(".")),
                ]
                for alias in node.names:
                    module = "/".join([*base, alias.name])
                    found[name].add(module if module in files else "/".join(base))
    return found


def room(module):
    """The folder of a module; a file beside `__init__.py` that is a room of its own; else the root, ''."""
    first = module.split("/")[0]
    return first if first in ROOMS else ""


def test_imports_point_downwards():
    upward = [
        f"{name} imports {module}"
        for name, modules in imports().items()
        for module in modules
        if ROOMS.index(room(name)) > ROOMS.index(room(module))
    ]
    assert not upward


def test_no_file_imports_itself_by_a_detour():
    try:
        TopologicalSorter(imports()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_the_imports_are_found():
    found = imports()
    assert "ui/panels" in found["__init__"] and "blender/mesh" in found["blender/surface"]
    assert "contract/errors" in found["blender/mesh"] and "layout" in found["bridge/interpreter"]
