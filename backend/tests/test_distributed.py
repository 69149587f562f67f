"""Two real processes under torchrun: the same texture as one alone, one voice, and one end for all."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest
import torch
from dante_w.run import distributed
from dante_w.scene.images import read_photo
from square_scene import make_scene

OPTIONS = ["--irradiance", "field", "--preset", "draft", "--texture-size", "64", "--json"]
#: Runs the command; the process of this number fails in the way that the first argument says, once it has met the others.
FAILING = """
import os, signal, sys
from dante_w.commands import cli
from dante_w.run import distributed
from dante_w.commands import recover
from dante_w.contract.errors import OutOfRoom

how, join = sys.argv.pop(1), distributed.join

def fail(device):
    join(device)
    if os.environ["RANK"] == "1":
        if how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        raise OutOfRoom("There is no room here.") if how == "room" else ZeroDivisionError("odd")

distributed.join = fail
sys.exit(cli.main())
"""

#: Three steps of each of three kinds on this process's half of each batch; the parameters go to `FOLDER/KIND-PROCESSES-RANK.npy`.
STEPS = """
import sys
import numpy as np, torch
from dante_w.run import distributed
from dante_w.field.step import TorchStep
from dante_w.field.terms import LossTerms
from dante_w.field.cpu.step import CpuStep
from dante_w.field.cuda.step import CudaStep
sys.path.insert(0, sys.argv[2])
from test_cpu_step import SPECS, all_of, some_model, some_samples

distributed.join(torch.device("cpu"))
for kind in [TorchStep, CpuStep] + [CudaStep] * (sys.argv[3] == "triton"):
    model, samples = some_model(SPECS["hash"]), some_samples(300, prior=True)
    count = 300 // distributed.world()
    own = slice(distributed.rank() * count, (distributed.rank() + 1) * count)
    parts = {name: getattr(samples, name)[own] for name in vars(samples)}
    step = kind(model, LossTerms(), all_of(model), 1e-2)
    for _ in range(3):
        step.gradients(type(samples)(**parts))
        step.update(1.0, distributed.mean)
    flat = torch.cat([parameter.detach().reshape(-1) for parameter in model.parameters()])
    np.save(f"{sys.argv[1]}/{kind.__name__}-{distributed.world()}-{distributed.rank()}.npy", flat.numpy())
if distributed.world() > 1:  # its threads abort a Python that ends by itself; the command does not, see `cli.main`
    torch.distributed.destroy_process_group()
"""


def start(arguments: list[str], processes: int = 2) -> subprocess.Popen:
    command = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--standalone",
        "--nproc-per-node",
        str(processes),
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}
    return subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )


def lines(out: str) -> list[dict]:
    return [json.loads(line) for line in out.splitlines()]


def texture(out: Path) -> np.ndarray:
    return read_photo(out / "albedo.png").srgb


def alone(scene: Path, out: Path, seed: int = 0) -> np.ndarray:
    command = [sys.executable, "-m", "dante_w", "recover", scene, *OPTIONS, "--seed", str(seed), "--out", out]
    subprocess.run(command, check=True, capture_output=True)
    return texture(out)


def test_a_process_alone_is_the_first_and_shares_nothing(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "4")  # set by a cluster's batch system, say
    monkeypatch.setenv("RANK", "3")
    assert (distributed.world(), distributed.rank()) == (1, 0)
    tensor = torch.ones(3)
    distributed.join(torch.device("cpu"))
    distributed.mean(tensor)
    distributed.check()
    assert torch.equal(tensor, torch.ones(3))
    assert distributed.own(np.arange(6).reshape(3, 2)).tolist() == [[0, 1], [2, 3], [4, 5]]


def test_every_photo_is_one_processes(monkeypatch):
    ranges = np.arange(14).reshape(7, 2)
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")
    monkeypatch.setenv("WORLD_SIZE", "3")
    parts = []
    for rank in range(3):
        monkeypatch.setenv("RANK", str(rank))
        parts.append(distributed.own(ranges))
        assert len(distributed.own(ranges[:2])) == 2
    assert sorted(np.concatenate(parts).tolist()) == ranges.tolist()


@pytest.mark.slow
def test_steps_on_halves_of_a_batch_are_those_on_all_of_it(tmp_path):
    script, has_triton = tmp_path / "steps.py", "triton" if find_spec("triton") else "none"
    script.write_text(STEPS)
    for processes in (1, 2):
        run = start([str(script), str(tmp_path), str(Path(__file__).parent), has_triton], processes)
        assert run.wait(120) == 0, run.stderr.read()
    for kind in ("TorchStep", "CpuStep", "CudaStep")[: 2 + (has_triton == "triton")]:
        whole, first, second = (np.load(tmp_path / f"{kind}-{name}.npy") for name in ("1-0", "2-0", "2-1"))
        assert first.tobytes() == second.tobytes()
        # Adam's first steps have the gradients' signs, which rounding decides where a gradient is nearly 0
        assert np.quantile(np.abs(first - whole), 0.99) < 1e-3


@pytest.mark.slow
def test_two_processes_recover_what_one_does(tmp_path):
    scene = make_scene(tmp_path / "scene")
    out, err = (
        run := start(["-m", "dante_w", "recover", str(scene), *OPTIONS, "--out", str(tmp_path / "two")])
    ).communicate()
    assert run.returncode == 0, err
    said = lines(out)  # each line is whole and one process's: stages come once and in order
    assert [line["stage"] for line in said].count("done") == 1
    stages = list(dict.fromkeys(line["stage"] for line in said))
    assert stages == [
        "scene",
        "expected",
        "rays",
        "planned",
        "optimise",
        "held-out",
        "final pass",
        "bake",
        "write",
        "done",
    ]
    assert sorted(path.name for path in (tmp_path / "two").iterdir()) == [
        "albedo.png",
        "coverage.png",
        "report.json",
    ]
    one, other, two = (
        alone(scene, tmp_path / "one"),
        alone(scene, tmp_path / "other", seed=1),
        texture(tmp_path / "two"),
    )
    noise = np.abs(one - other).mean()
    assert 0.0 < np.abs(one - two).mean() < 0.3 * noise  # without sharing: 0.47 of it
    assert noise < 0.02


@pytest.mark.slow
def test_light_traced_through_the_mesh_is_the_work_of_the_first_process(tmp_path):
    scene = make_scene(tmp_path / "scene")
    options = ["--preset", "draft", "--texture-size", "64", "--json", "--out", str(tmp_path / "out")]
    out, err = (run := start(["-m", "dante_w", "recover", str(scene), *options])).communicate()
    assert run.returncode == 0, err
    assert [line["stage"] for line in lines(out)].count("done") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "code", "sentence"),
    [
        ("room", 4, "There is no room here."),
        ("bug", 1, "Internal error (ZeroDivisionError: odd); please report it with the log."),
    ],
)
def test_the_first_process_says_why_another_one_failed(tmp_path, how, code, sentence):
    scene, script = make_scene(tmp_path / "scene"), tmp_path / "failing.py"
    script.write_text(FAILING)
    run = start([str(script), how, "recover", str(scene), *OPTIONS, "--out", str(tmp_path / "out")])
    out, err = run.communicate(timeout=120)
    errors = [line for line in lines(out) if line["stage"] == "error"]
    assert errors == [{"stage": "error", "code": code, "message": sentence}]
    assert run.returncode == 1  # torchrun's own
    assert "exitcode" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_wrong_scene_is_one_error(tmp_path):
    run = start(
        ["-m", "dante_w", "recover", str(tmp_path / "none"), *OPTIONS, "--out", str(tmp_path / "out")]
    )
    out, _ = run.communicate(timeout=120)
    assert [line["code"] for line in lines(out) if line["stage"] == "error"] == [2]
    assert run.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize("whom", ["torchrun", "the second process's work"])
def test_they_end_together_and_leave_nothing(tmp_path, whom):
    scene = make_scene(tmp_path / "scene")
    options = ["--irradiance", "field", "--preset", "high", "--json", "--out", str(tmp_path / "out")]
    run = start(["-m", "dante_w", "recover", str(scene), *options])
    for line in run.stdout:
        if json.loads(line)["stage"] == "optimise":
            break
    family = psutil.Process(run.pid).children(recursive=True)
    began = time.monotonic()
    if whom == "torchrun":
        run.send_signal(signal.SIGTERM)
    else:
        second = next(p for p in family if p.environ().get("RANK") == "1" and not p.children())
        second.kill()
    rest, _ = run.communicate(timeout=60)
    error = [line for line in lines(rest) if line["stage"] == "error"]
    assert [line["code"] for line in error] == ([3] if whom == "torchrun" else [4])
    assert time.monotonic() - began < 40.0
    assert run.returncode != 0
    assert not psutil.wait_procs(family, timeout=10)[1]
    assert not (tmp_path / "out").exists()
