"""No pickle from a user's file, no shell, no code made from data, no network: read off the sources of backend and add-on."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = [
    *sorted((ROOT / "backend/dante_w").rglob("*.py")),
    ROOT / "backend/launch.py",
    *sorted((ROOT / "dante_w_addon").rglob("*.py")),
]
#: Modules that unpickle, start processes, load native code, or talk to the network.
MODULES = frozenset(
    str.split("""
    pickle cPickle _pickle dill cloudpickle joblib shelve marshal socket socketserver ssl urllib http
    requests ftplib smtplib xmlrpc asyncio websockets multiprocessing ctypes cffi subprocess pty runpy
    code webbrowser torch.distributed torch.hub numba.pycc
    """)
)
#: Calls, by their last names, that do one of these.
CALLS = frozenset(
    str.split("""
    eval exec compile __import__ os.system os.popen os.startfile os.spawnl os.spawnv os.execv os.execve
    torch.load torch.jit.load jit.load hub.load load_state_dict_from_url read_pickle import_module
    url_open urlopen urlretrieve
    """)
)
#: What is done all the same, and why.
ALLOWED = {
    "backend/dante_w/commands/supervisor.py subprocess": "the work runs in a process of its own, started by a list of words",
    "backend/dante_w/texture/unwrap.py subprocess": "xatlas cannot be interrupted, so it runs in a child",
    "backend/dante_w/texture/unwrap.py ctypes": "prctl: that child ends with its parent",
    "backend/dante_w/run/distributed.py torch.distributed": "only where torchrun, which the user starts, says so",
    "dante_w_addon/bridge/process.py subprocess": "the backend",
    "dante_w_addon/bridge/environment.py subprocess": "pip and the backend's doctor",
    "dante_w_addon/bridge/environment.py https": "wheels, downloaded by a button that needs Blender's online access",
    "dante_w_addon/batch.py import_module": "the add-on's own files under their package's name",
}


def uses(source: str) -> Iterator[str]:
    """What of the above a Python source does, also in the code that it holds as text."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from filter(None, (_module(alias.name) for alias in node.names))
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from {f"{node.module}.{alias.name}" for alias in node.names} & CALLS
            yield from filter(
                None, {_module(node.module), *(_module(f"{node.module}.{a.name}") for a in node.names)}
            )
        elif isinstance(node, ast.Call):
            yield from _call(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if "://" in node.value:
                yield node.value.partition("://")[0].split()[-1]
            if "import " in node.value and _is_code(node.value):
                yield from uses(node.value)


def _module(name: str) -> str | None:
    return next((known for known in MODULES if name == known or name.startswith(known + ".")), None)


def _call(node: ast.Call) -> Iterator[str]:
    words = ast.unparse(node.func).split(".")
    dotted = words[-1], ".".join(words[-2:])
    method = len(words) > 1 and words[0] not in ("os", "builtins", "torch", "importlib", "pd")
    if dotted[1] in CALLS or (dotted[0] in CALLS and not (method and dotted[0] in ("eval", "compile"))):
        yield next(each for each in (dotted[1], dotted[0]) if each in CALLS)
    for keyword in node.keywords:
        off = isinstance(keyword.value, ast.Constant) and keyword.value.value in (False, None)
        if keyword.arg in ("shell", "allow_pickle") and not off:
            yield keyword.arg
        if keyword.arg == "weights_only" and off:
            yield keyword.arg


def _is_code(text: str) -> bool:
    try:
        ast.parse(text)
    except SyntaxError:
        return False
    return True


def test_only_what_is_allowed_is_done():
    found = {
        f"{file.relative_to(ROOT).as_posix()} {use}"
        for file in FILES
        for use in uses(file.read_text("utf-8"))
    }
    assert not found - set(ALLOWED), "done without a reason"
    assert not set(ALLOWED) - found, "allowed, but not done any more"


@pytest.mark.parametrize(
    ("source", "use"),
    [
        ("import pickle", "pickle"),
        ("from urllib.request import urlopen", "urllib"),
        ("import os\nos.system('x')", "os.system"),
        ("from os import popen", "os.popen"),
        ("subprocess.run('x', shell=True)", "shell"),
        ("np.load(f, allow_pickle=True)", "allow_pickle"),
        ("np.load(f, allow_pickle=wanted)", "allow_pickle"),
        ("torch.load(f)", "torch.load"),
        ("eval('1')", "eval"),
        ("CODE = 'import socket; socket.socket()'", "socket"),
        ("import torch.distributed as together", "torch.distributed"),
        ("from torch import hub", "torch.hub"),
        ("URL = 'https://example.org'", "https"),
    ],
)
def test_the_search_finds(source, use):
    assert use in set(uses(source))


def test_the_search_passes_over_what_is_harmless():
    assert not list(
        uses(
            "np.load(f, allow_pickle=False)\nplatform.system()\nre.compile('x')\nmodel.eval()\nimport httpx_like"
        )
    )


def test_blenders_process_has_one_thread():
    """Blender's API documentation warns of Python threads: they crash it beside Cycles."""
    modules = {"threading", "_thread", "concurrent", "multiprocessing", "queue"}
    for file in (ROOT / "dante_w_addon").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not {name.split(".")[0] for name in names} & modules, file.name


def test_only_the_set_up_button_downloads_and_it_asks_for_online_access():
    callers = [
        file.name
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "environment.commands"
    ]
    assert callers == ["setup.py"]
    tree = ast.parse((ROOT / "dante_w_addon/operators/setup.py").read_text("utf-8"))
    (button,) = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and "environment.commands" in ast.unparse(node)
    )
    (poll,) = (node for node in button.body if isinstance(node, ast.FunctionDef) and node.name == "poll")
    assert "not bpy.app.online_access" in ast.unparse(poll)
