"""The shape of the sources, read off them: which room may import which, and how long files and parameter lists may be."""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "backend/dante_w"
#: Rooms of the backend from the bottom up. A room imports from itself and from rooms below its line.
FLOORS = (
    ("dante_w", "contract"),
    ("core", "options"),
    ("scene",),
    ("rays",),
    ("texture",),
    ("run",),
    ("traced", "field"),
    ("presets",),
    ("estimate",),
    ("commands",),
    ("__main__",),
)
ENTRIES, LINES, PARAMETERS = 14, 350, 7
#: What makes a function a compiled kernel: these take arrays one by one.
COMPILERS = ("jit", "njit", "njit_fast", "njit_inlined", "njit_parallel", "njit_parallel_fast")

# Exceptions, each until somebody has mended it. They can only become fewer: one that is not needed any more fails.
CIRCLES: frozenset[str] = frozenset()
LONG_FILES = frozenset(
    str.split("""
    backend/tests/test_scene_folder.py
    benchmarks/extremes/broken_files.py
    benchmarks/extremes/fuzz.py
    benchmarks/tradeoff.py
    """)
)
LONG_PARAMETER_LISTS: frozenset[str] = frozenset()


@cache
def sources() -> tuple[Path, ...]:
    """Every Python file of the repository."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"]
    done = subprocess.run(listed, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    files = [ROOT / name for name in done.stdout.split()] or [
        path
        for folder in ("backend", "benchmarks", "blender_tests", "dante_w_addon")
        for path in (ROOT / folder).rglob("*.py")
    ]
    return tuple(sorted(path for path in files if path.is_file()))


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module: str) -> str:
    """The folder of a module; a file beside `__init__.py` is a room of its own."""
    return module.split(".")[1] if "." in module else module


@cache
def imports() -> dict[str, set[str]]:
    """What each module of the backend imports of it, anywhere in its source: for types or inside of functions, too."""
    modules = {module_of(path): path for path in PACKAGE.rglob("*.py")}
    found: dict[str, set[str]] = {}
    for module, path in modules.items():
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                package = module if path.name == "__init__.py" else module.rpartition(".")[0]
                base = resolve_name("." * node.level + (node.module or ""), package)
                whole = {f"{base}.{alias.name}" for alias in node.names}
                names |= {name if name in modules else base for name in whole}
        found[module] = names & set(modules)
    return found


def in_circles(graph: dict[str, set[str]]) -> set[str]:
    """The nodes of a graph from which a way leads back to themselves."""

    def reached(start: str) -> Iterator[str]:
        waiting, known = list(graph[start]), set()
        while waiting:
            node = waiting.pop()
            if node not in known:
                known.add(node)
                waiting += graph[node]
                yield node

    return {node for node in graph if node in reached(node)}


def test_imports_point_downwards():
    floor = {name: number for number, names in enumerate(FLOORS) for name in names}
    rooms = {room(module) for module in imports()}
    assert rooms == set(floor), "a room has no floor, or a floor no room"
    upward = {
        f"{module} imports {other}"
        for module, others in imports().items()
        for other in others
        if room(module) != room(other) and floor[room(module)] <= floor[room(other)]
    }
    assert not upward


def test_no_file_needs_itself():
    assert in_circles(imports()) == CIRCLES


def test_the_folders_top_is_seen_at_once():
    entries = [path for path in PACKAGE.iterdir() if path.suffix == ".py" or any(path.rglob("*.py"))]
    assert len(entries) <= ENTRIES


def test_files_are_short():
    long = {
        path.relative_to(ROOT).as_posix()
        for path in sources()
        if len(path.read_text("utf-8").splitlines()) > LINES
    }
    assert long == LONG_FILES


def long_parameter_lists(source: str) -> Iterator[str]:
    """The names of functions with too many parameters that are no kernels."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        arguments = node.args
        names = [each.arg for each in arguments.posonlyargs + arguments.args + arguments.kwonlyargs]
        decorators = [each.func if isinstance(each, ast.Call) else each for each in node.decorator_list]
        compiled = any(ast.unparse(each).split(".")[-1] in COMPILERS for each in decorators)
        if not compiled and len([name for name in names if name not in ("self", "cls")]) > PARAMETERS:
            yield node.name


def test_parameter_lists_are_short():
    long = {
        f"{path.relative_to(ROOT).as_posix()}:{name}"
        for path in sources()
        for name in long_parameter_lists(path.read_text("utf-8"))
    }
    assert long == LONG_PARAMETER_LISTS


def test_the_search_finds():
    """What the tests above rely on, on sources where the answer is plain."""
    assert in_circles({"a": {"b"}, "b": {"a"}, "c": {"a"}, "d": {"d"}}) == {"a", "b", "d"}
    assert "dante_w.traced.shading_points" in imports()["dante_w.traced.pipeline"]
    assert "dante_w.contract.errors" in imports()["dante_w.contract.scene_folder"]
    assert "dante_w.commands.cli" in imports()["dante_w.commands.supervisor"]
    many = "a, b, c, d, e, f, g, *, h"
    assert list(long_parameter_lists(f"def far({many}): ...\ndef near(self, a, b, c, d, e, f, g): ...")) == [
        "far"
    ]
    assert not list(long_parameter_lists(f"@njit\ndef kernel({many}): ..."))
    with pytest.raises(SyntaxError):
        list(long_parameter_lists("def broken(:"))
