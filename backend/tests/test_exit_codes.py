"""How the command ends when it cannot go on: bad input, no memory, a bug, a signal."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_runs import FIELD, SMALL, run
from dante_w.commands import recover_traced
from dante_w.commands.cli import main
from dante_w.scene.images import write_png
from square_scene import SQUARE, make_scene


def broken_scenes(folder: Path) -> dict[str, tuple[list[str], str]]:
    """Arguments and what the message must name, for each kind of bad input; made in `folder`."""
    cases: dict[str, tuple[list[str], str]] = {}

    def case(name: str, message: str, *extra: str) -> Path:
        made = make_scene(folder / name, photos=2)
        cases[name] = ([str(made), *extra], message)
        return made

    (case("missing image", r"1\.png") / "1.png").unlink()
    (case("unreadable image", r"1\.png") / "1.png").write_bytes(b"\x89PNG\r\n\x1a\nnot really")
    write_png(
        case("image size unlike its camera", r"1\.png.*40 x 30") / "1.png", np.zeros((30, 40, 3), np.uint8)
    )
    made = case("nan pose", "frame 0") / "transforms.json"
    made.write_text(
        re.sub(r'"transform_matrix": \[\[[0-9.]+', '"transform_matrix": [[NaN', made.read_text(), count=1)
    )
    (case("empty mesh", r"mesh\.obj") / "mesh.obj").write_text("")
    (case("no mesh", "--mesh") / "mesh.obj").unlink()
    (case("overlapping uvs", "--unwrap") / "mesh.obj").write_text(
        SQUARE.replace("f 1/1 3/3 4/4", "f 1/1 3/2 4/3")
    )
    (case("no pixel sees the mesh", "coordinate system") / "mesh.obj").write_text(
        re.sub(r"v (\d) (\d) 0", r"v 9\1 9\2 0", SQUARE)
    )
    case("no such priors", "priors", "--priors", str(folder / "nowhere"))
    case("nothing to fit to", "--priors", "--no-photometric")
    cases["no scene"] = ([str(folder / "nothing")], "nothing")
    if not os.path.exists("/dev/nvidiactl"):
        case("no such device", "--device cuda", *FIELD, "--device", "cuda")
    return cases


def test_bad_input_ends_in_one_sentence_and_loses_nothing(tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "albedo.png").write_text("former result")
    (out / "report.json").write_text(json.dumps({"dante_w": "0.1.0", "files": ["albedo.png", "report.json"]}))
    for name, (arguments, message) in broken_scenes(tmp_path).items():
        code = main(["recover", *arguments, "--out", str(out), "--json"], settings=SMALL)
        captured = capsys.readouterr()
        last = json.loads(captured.out.splitlines()[-1])
        assert (code, last["stage"], last["code"]) == (2, "error", 2), (name, last)
        assert re.search(message, last["message"]), (name, last["message"])
        assert "\n" not in last["message"] and "Traceback" not in captured.err, name
        assert sorted(p.name for p in out.iterdir()) == ["albedo.png", "report.json"], name
    assert (out / "albedo.png").read_text() == "former result"


def test_wrong_options_are_bad_input_too():
    for arguments in (["recover"], ["recover", "x", "--out", "y", "--texture-size", "0"], ["fly"]):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 2


def test_memory_and_disk_have_their_own_exit_code(square, tmp_path, monkeypatch):
    def fail(error):
        def raise_it(*_):
            raise error

        return raise_it

    for error in (MemoryError(), OSError(28, "No space left on device", "albedo.png")):
        monkeypatch.setattr(recover_traced, "look", fail(error))
        code, events = run("recover", square, "--out", tmp_path / "out")
        assert code == 4 and events[-1]["code"] == 4
        assert not (tmp_path / "out").exists()
    monkeypatch.setattr(recover_traced, "look", fail(ZeroDivisionError("a bug")))
    assert run("recover", square, "--out", tmp_path / "out")[0] == 1


@pytest.mark.alone
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM to handle")
@pytest.mark.parametrize(
    ("wanted", "irradiance", "preset"),
    [("rays", "field", "paper"), ("optimise", "field", "paper"), ("lights", "traced", "high")],
)
def test_signals_end_the_run_within_a_second(square, tmp_path, wanted, irradiance, preset):
    out = tmp_path / "out"
    options = ["--irradiance", irradiance, "--preset", preset, "--json"]
    command = [sys.executable, "-m", "dante_w", "recover", str(square), "--out", str(out), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if json.loads(line)["stage"] == wanted:
                break
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        rest = process.stdout.read().splitlines()
        assert process.wait(10) == 3
        assert time.monotonic() - began < 3.0  # a second, on a machine with nothing else to do
    assert json.loads(rest[-1]) == {
        "stage": "error",
        "code": 3,
        "message": "Cancelled; the former result, if any, is untouched.",
    }
    assert not out.exists()
