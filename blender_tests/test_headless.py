"""The command without a window, called as a user would: in a process of its own, through the bpy module."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest
from conftest import HERE, ROOT

from dante_w_addon.bridge import headless
from dante_w_addon.bridge.process import Process

BATCH = ROOT / "dante_w_addon" / "batch.py"


@pytest.fixture
def blend(scene):
    return bpy.data.filepath


def command(blend, out, *more):
    """batch.py, with the stand-in for a backend."""
    code = (
        "import runpy, sys; sys.path.insert(0, sys.argv.pop(1)); import bpy, batch; "
        "headless = batch.load(); from pathlib import Path; "
        f"from dante_w_addon import layout; layout.launcher = lambda: Path({str(HERE / 'standin' / 'launch.py')!r}); "
        "sys.exit(headless.main(batch.arguments()))"
    )
    words = [str(blend), "--out", str(out), "--backend-python", sys.executable, *more]
    return [sys.executable, "-c", code, str(BATCH.parent), *words]


def run(blend, out, *more, mode="done"):
    env = {**os.environ, "STANDIN": mode}
    return subprocess.run(command(blend, out, *more), capture_output=True, text=True, env=env, check=False)


def test_recovers_saves_and_relights(blend, tmp_path):
    out = tmp_path / "out"
    done = run(blend, out, "--json", "--relight", "forest", "--samples", "1", "--size", "32")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert lines[-1]["stage"] == "done" and lines[-1]["report"]["held_out_psnr"] == 31.5
    assert "optimise" in {line["stage"] for line in lines}
    assert (out / "relight.png").is_file() and (out / "albedo.png").is_file()
    bpy.ops.wm.open_mainfile(filepath=str(out / "small scene.blend"))
    cube = bpy.data.objects["Cube"]
    image = cube.active_material.node_tree.nodes.active.image
    assert image.packed_file is None and image.filepath == "//albedo.png", "the folder may be moved"
    assert cube["dante_w_originals"]["0"].name == "Original"


def test_the_word_recover_may_be_said(blend, tmp_path):
    words = command(blend, tmp_path / "out", "--pack")
    words.insert(4, "recover")
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "small scene.blend"))
    assert bpy.data.objects["Cube"].active_material.node_tree.nodes.active.image.packed_file


@pytest.mark.parametrize(
    ("more", "mode", "code", "said"),
    [
        ((), "bad", 2, "no UVs"),
        ((), "crash", 1, "something unforeseen"),
        (("--object", "Sphere"), "done", 2, "no mesh named Sphere"),
        (("--relight", "moonlight"), "done", 2, "moonlight"),
        (("--preset", "best"), "done", 2, "best"),
        (("--preset", "paper"), "done", 2, "needs --irradiance field"),
    ],
)
def test_exit_codes(blend, tmp_path, more, mode, code, said):
    done = run(blend, tmp_path / "out", *more, mode=mode)
    assert done.returncode == code, done.stderr
    assert said in done.stderr and "Traceback (most" not in done.stderr
    assert not list(tmp_path.glob("out/*.blend"))


def test_what_to_model_reaches_the_backend(blend, tmp_path):
    options = ["--model", "clusters", "--model", "bounce", "--leave-out", "gloss"]
    assert run(blend, tmp_path / "out", "--irradiance", "traced", *options).returncode == 0
    given = " ".join(json.loads((tmp_path / "out/report.json").read_text())["arguments"])
    assert "--irradiance traced" in given
    assert "--model groups --model bounce --leave-out gloss" in given, "the keys, which every backend knows"
    assert run(blend, tmp_path / "other").returncode == 0
    given = json.loads((tmp_path / "other/report.json").read_text())["arguments"]
    assert given[given.index("--irradiance") + 1] == "traced" and "--model" not in given


def test_a_missing_blend_is_bad_input(tmp_path):
    done = run(tmp_path / "none.blend", tmp_path / "out")
    assert done.returncode == 2 and "none.blend" in done.stderr


def test_the_scene_itself_is_never_replaced(blend):
    """`--out` names the folder of the .blend that is open."""
    file = Path(blend)
    before = file.read_bytes()
    done = run(blend, file.parent)
    assert done.returncode == 2 and "--out" in done.stderr and "scene itself" in done.stderr
    assert file.read_bytes() == before and not (file.parent / "report.json").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_cancel(blend, tmp_path, number):
    env = {**os.environ, "STANDIN": "slow"}
    words = command(blend, tmp_path / "out", "--json")
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
    while '"optimise"' not in process.stdout.readline():
        assert process.poll() is None
    before = time.monotonic()
    process.send_signal(number)
    process.communicate(timeout=10)
    assert process.returncode == 3
    assert time.monotonic() - before < 3.0  # a second, on a machine with nothing else to do


def test_blenders_own_signal_handlers_are_no_obstacle(monkeypatch):
    """Blender sets its handler in C; Python then says None for it, and takes no None back."""
    real = signal.signal
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def as_in_blender(number, handler):
        real(number, handler)  # raises TypeError for None

    monkeypatch.setattr(signal, "signal", as_in_blender)
    try:
        assert headless._follow(Process([sys.executable, "-c", "raise SystemExit(4)"]), True).code == 4
    finally:
        for number, handler in kept.items():
            real(number, handler)


def test_batch_runs_by_itself(blend, tmp_path):
    """batch.py as a script, with arguments after `--`: here up to the backend that is not one."""
    words = [
        sys.executable,
        str(BATCH),
        "--",
        str(blend),
        "--out",
        str(tmp_path / "o"),
        "--backend-python",
        "/none",
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "/none" in done.stderr, done.stderr
