"""Ending the backend: cancel, another file, Blender's end."""

import subprocess
import sys
import time

import bpy
import pytest
from conftest import HERE, ROOT
from running import alive, finish

from dante_w_addon.blender import material
from dante_w_addon.bridge import job


def child_of_stubborn(folder):
    """Wait for the process that the stand-in starts; it ignores SIGTERM, too."""
    file = folder / "dante_w" / "Cube" / "scene" / "child.pid"
    end = time.monotonic() + 20.0
    while not file.exists() or not file.read_text():
        assert time.monotonic() < end
        time.sleep(0.02)
    return int(file.read_text())


@pytest.mark.parametrize("mode", ["slow", "stubborn"])
def test_cancel_within_a_second_leaves_no_orphan(addon, standin, scene, tmp_path, mode):
    standin(mode)
    bpy.ops.dantew.recover()
    pids = [job.recovery.process.pid]
    if mode == "stubborn":
        pids.append(child_of_stubborn(tmp_path))
    while job.recovery.progress.step.stage != "optimise":
        job.tick()
        time.sleep(0.02)
    assert all(map(alive, pids))
    before = time.monotonic()
    bpy.ops.dantew.cancel()
    assert time.monotonic() - before < 0.5, "cancel must not wait"
    while any(map(alive, pids)):
        # a second, on a machine with nothing else to do
        assert time.monotonic() - before < 3.0, "still running"
        time.sleep(min(job.tick() or 0.01, 0.05))
    assert finish().state == "cancelled"
    assert material.display_of(bpy.data.objects["Cube"]) is None


@pytest.mark.parametrize("mode", ["slow", "stubborn"])
def test_opening_another_file_stops_the_backend(addon, standin, scene, tmp_path, mode):
    standin(mode)
    bpy.ops.dantew.recover()
    pids = [job.recovery.process.pid]
    if mode == "stubborn":
        pids.append(child_of_stubborn(tmp_path))
    assert all(map(alive, pids))
    bpy.ops.wm.read_homefile(use_empty=True)
    deadline = time.monotonic() + 5.0  # a killed process takes a moment to go where others are at work
    while any(map(alive, pids)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(map(alive, pids))
    assert job.recovery is None


QUIT = """
import sys
sys.path[:0] = [{root!r}, {here!r}]
import bpy, dante_w_addon
from dante_w_addon import layout
from dante_w_addon.bridge import job
from pathlib import Path
layout.launcher = lambda: Path({here!r}) / "standin" / "launch.py"
bpy.ops.wm.open_mainfile(filepath={blend!r})
dante_w_addon.register()
bpy.ops.dantew.recover()
print(job.recovery.process.pid, flush=True)
{end}
"""


@pytest.mark.parametrize("end", ["", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"])
def test_quitting_or_killing_blender_leaves_no_backend(standin, scene, end):
    standin("slow")
    code = QUIT.format(root=str(ROOT), here=str(HERE), blend=bpy.data.filepath, end=end)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    pid = int(next(line for line in done.stdout.splitlines() if line.isdigit()))
    until = time.monotonic() + 3.0  # a killed Blender cannot stop it; its next line finds nobody listening
    while alive(pid):
        assert time.monotonic() < until
        time.sleep(0.02)
