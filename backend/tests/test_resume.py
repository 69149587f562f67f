"""Checkpoints: a run that was killed and resumed comes to the same bytes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from dante_w.run import checkpoints
from dante_w.run.checkpoints import Checkpoints, open_checkpoints
from dante_w.scene.load import load_scene
from small_settings import small_preset

#: The command, small, which keeps everything; with KILL "STAGE STEP" it strikes itself there by kill -9.
COMMAND = """
import os, signal, sys
from dante_w.run import checkpoints
from dante_w.commands import cli
from small_settings import small_preset
from dante_w.run.progress import Progress
checkpoints.SECONDS = 0.0
update, kill = Progress.update, os.environ.get("KILL", "").split(":")
def struck(self, stage, step, *more):
    if stage == kill[0] and step >= float(kill[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    update(self, stage, step, *more)
Progress.update = struck
sys.exit(cli.main(settings=small_preset(64, 60, 30, 'draft')))
"""


def run(scene: Path, out: Path, *options: str, kill: str = "") -> tuple[int, dict]:
    command = [sys.executable, "-c", COMMAND, "recover", scene, "--out", out, "--preset", "draft", "--json"]
    done = subprocess.run(
        [*command, *options],
        capture_output=True,
        text=True,
        env={**os.environ, "KILL": kill, "PYTHONPATH": str(Path(__file__).parent)},
        check=False,
    )
    return done.returncode, json.loads(done.stdout.splitlines()[-1])


def kept(out: Path) -> list[str]:
    return sorted(path.name for path in (out / ".resume").glob("*/"))


CASES = [
    pytest.param("field", "optimise:35", ["fit", "rays"], id="in the fit"),
    pytest.param("traced", "lights:3", ["plan", "rays", "transfer"], id="in the lights"),
    pytest.param("field", "final pass:15", ["final fit", "fit", "rays"], marks=pytest.mark.slow),
    pytest.param("field", "write:0", ["final fit", "fit", "rays"], marks=pytest.mark.slow),
    pytest.param("traced", "plan:0", ["rays", "transfer"], marks=pytest.mark.slow),
    pytest.param("traced", "albedo:0.5", ["lights", "plan", "rays", "transfer"], marks=pytest.mark.slow),
]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no kill -9 to send")
@pytest.mark.parametrize(("irradiance", "kill", "names"), CASES)
def test_a_killed_run_resumes_to_the_same_bytes(scene, tmp_path, irradiance, kill, names):
    options = ("--irradiance", irradiance)
    out, whole = tmp_path / "out", tmp_path / "whole"
    assert run(scene, out, *options, kill=kill)[0] == -9
    assert kept(out) == names and not (out / "report.json").exists()
    code, last = run(scene, out, *options, "--resume")
    assert code == 0, last
    assert sorted(last["report"]["resumed"]) == names
    assert sorted(path.name for path in out.iterdir()) == ["albedo.png", "coverage.png", "report.json"]
    assert run(scene, whole, *options)[1]["report"]["resumed"] == []
    for name in ("albedo.png", "coverage.png"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()


@dataclass(frozen=True)
class Inner:
    numbers: np.ndarray
    name: str


@dataclass(frozen=True)
class Outer:
    inner: Inner
    tensor: torch.Tensor
    nothing: np.ndarray | None
    something: np.ndarray | None
    level: float
    many: list[Inner]
    pair: tuple[np.ndarray, ...]


def outer() -> Outer:
    inner = Inner(np.arange(6, dtype=np.uint16).reshape(2, 3), "häß")
    return Outer(
        inner, torch.ones(2), None, np.array([np.nan, -0.0]), 0.1, [inner], (np.zeros(0), np.ones(1))
    )


def fresh(folder: Path, monkeypatch, seconds: float = 0.0) -> Checkpoints:
    monkeypatch.setattr(checkpoints, "SECONDS", seconds)
    return Checkpoints(folder / ".resume", "key")


def test_what_is_kept_reads_back_bit_for_bit(tmp_path, monkeypatch):
    fresh(tmp_path, monkeypatch).save("a", outer())
    found, expected = fresh(tmp_path, monkeypatch).load("a", Outer), outer()
    assert found is not None and found.nothing is None and found.level == expected.level
    assert found.something.tobytes() == expected.something.tobytes() and found.many[0].name == "häß"
    assert found.inner.numbers.dtype == np.uint16 and (found.inner.numbers == expected.inner.numbers).all()
    assert torch.equal(found.tensor, expected.tensor) and [len(each) for each in found.pair] == [0, 1]


def test_little_work_is_not_kept(tmp_path, monkeypatch):
    fresh(tmp_path, monkeypatch, 60.0).save("a", outer())
    assert not (tmp_path / ".resume").exists()


@pytest.mark.parametrize("spoil", ["cut", "no tree", "pickle", "no file"])
def test_damaged_checkpoints_are_as_good_as_none(tmp_path, monkeypatch, spoil):
    fresh(tmp_path, monkeypatch).save("a", outer())
    folder = tmp_path / ".resume" / "a"
    if spoil == "cut":
        (folder / "0.npy").write_bytes((folder / "0.npy").read_bytes()[:100])
    elif spoil == "no tree":
        (folder / "tree.json").write_text("{")
    elif spoil == "pickle":
        np.save(folder / "0.npy", np.array([print], object), allow_pickle=True)
    else:
        (folder / "1.npy").unlink()
    again = fresh(tmp_path, monkeypatch)
    assert again.load("a", Outer) is None and again.resumed == []
    assert again.done("a", Outer, outer).level == 0.1


def test_checkpoints_belong_to_their_inputs(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    options = SimpleNamespace(out=tmp_path, resume=True, seed=0, format="png")
    loaded, settings = load_scene(scene), [small_preset(64)]
    open_checkpoints(options, settings[0], *loaded).save("a", outer())
    options.format = "exr"  # no reason to begin again
    assert open_checkpoints(options, settings[0], *loaded).load("a", Outer) is not None
    photo = scene / "0.png"
    stamp = photo.stat()
    for change in (
        lambda: setattr(options, "seed", 1),
        lambda: settings.insert(0, small_preset(64, steps=299)),
        lambda: os.utime(photo, ns=(stamp.st_atime_ns, stamp.st_mtime_ns + 1)),
        lambda: setattr(options, "resume", False),
    ):
        open_checkpoints(options, settings[0], *loaded).save("a", outer())
        change()
        assert open_checkpoints(options, settings[0], *loaded).load("a", Outer) is None
        assert not (tmp_path / ".resume").exists()
