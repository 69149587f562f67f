"""Fixtures: an empty Blender, the add-on registered, a small scene with photos, the stand-in backend."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import bpy
import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

import dante_w_addon  # noqa: E402
from dante_w_addon import layout  # noqa: E402
from dante_w_addon.bridge import job  # noqa: E402
from dante_w_addon.operators import relight  # noqa: E402


@pytest.fixture(autouse=True)
def empty_file():
    """Each test starts with an empty .blend."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield
    job.stop()


@pytest.fixture
def addon():
    """The add-on, registered."""
    dante_w_addon.register()
    yield dante_w_addon
    dante_w_addon.unregister()


@pytest.fixture
def no_temporary_files():
    """Whatever the test does with previews, Blender's temporary folder is afterwards as it was."""
    before = os.listdir(bpy.app.tempdir)
    yield
    relight.stop()
    assert os.listdir(bpy.app.tempdir) == before


@pytest.fixture
def standin(monkeypatch):
    """The stand-in backend in this Python; returns a function that sets how it behaves."""
    monkeypatch.setattr(layout, "launcher", lambda: HERE / "standin" / "launch.py")
    monkeypatch.setenv("DANTEW_BACKEND_PYTHON", sys.executable)

    def behave(mode: str) -> None:
        monkeypatch.setenv("STANDIN", mode)

    return behave


@pytest.fixture
def scene(tmp_path):
    """A UV-mapped cube, four cameras with photos, saved as a .blend in `tmp_path`."""
    from small_scene import build

    build(tmp_path / "photos")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "small scene.blend"))
    return bpy.context.scene


@pytest.fixture(scope="session")
def backend_python() -> str:
    """The real backend's Python."""
    python = os.environ.get("DANTEW_BACKEND_PYTHON")
    if not python:
        pytest.skip("DANTEW_BACKEND_PYTHON does not name the backend's Python (dev.py test sets it)")
    return python
