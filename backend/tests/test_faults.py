"""What a fault leaves behind: the former result, no process, nothing that the next run does not clean up."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import psutil
import pytest
import torch
from dante_w.commands import stages
from dante_w.commands import worker as job
from dante_w.commands.cli import main
from dante_w.contract.errors import BadInput, Cancelled
from dante_w.contract.protocol import Step
from dante_w.run import own_folders, result_folder, scratch
from dante_w.run.progress import Progress

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no kill -9 to send")
NAMES = ("albedo.png", "coverage.png", "report.json")


def report(word: str, names: Sequence[str] = NAMES) -> str:
    return json.dumps({"dante_w": "0.1.0", "word": word, "files": list(names)})


RESULT = {"albedo.png": "new", "coverage.png": "new", "report.json": report("new")}


def staged(out: Path) -> Path:
    staging = result_folder.stage(out, NAMES)
    for name, text in RESULT.items():
        (staging / name).write_text(text)
    (staging / "rays").mkdir()
    (staging / "rays" / "face").write_text("0")
    return staging


def former(out: Path) -> dict[str, str]:
    out.mkdir(exist_ok=True)
    result = {"albedo.png": "former", "coverage.png": "former", "report.json": report("former")}
    for name, text in result.items():
        (out / name).write_text(text)
    return result


def content(out: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in out.iterdir() if path.is_file()}


@pytest.mark.parametrize("renamed", range(5))
def test_a_result_half_in_place_is_completed_by_whoever_comes_next(tmp_path, monkeypatch, renamed):
    former(tmp_path)
    staged(tmp_path)
    replace, done = os.replace, []

    def struck(source, target):
        if len(done) == renamed:
            raise KeyboardInterrupt
        done.append(target)
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", struck)
        if renamed < 4:
            with pytest.raises(KeyboardInterrupt):
                result_folder.publish(tmp_path)
            assert ("report.json" in content(tmp_path)) == (renamed == 0)
        else:
            result_folder.publish(tmp_path)
    result_folder.abandon(tmp_path)
    assert content(tmp_path) == RESULT and len(list(tmp_path.iterdir())) == 3


def test_before_the_staging_folder_is_whole_the_former_result_stands(tmp_path):
    expected = former(tmp_path)
    staged(tmp_path)
    result_folder.stage(tmp_path, NAMES)  # the next run, after a kill
    assert content(tmp_path) == expected
    result_folder.abandon(tmp_path)
    assert content(tmp_path) == expected and len(list(tmp_path.iterdir())) == 3


def test_a_folder_in_a_files_place_is_refused_before_anything_is_moved(tmp_path):
    former(tmp_path)
    (tmp_path / "albedo.png").unlink()
    expected = content(tmp_path)
    staging = staged(tmp_path)
    (tmp_path / "albedo.png").mkdir()
    with pytest.raises(BadInput, match=r"albedo\.png"):
        result_folder.publish(tmp_path)
    assert content(tmp_path) == expected and staging.is_dir()
    result_folder.abandon(tmp_path)
    with pytest.raises(BadInput, match=r"albedo\.png"):
        result_folder.stage(tmp_path, NAMES)
    assert content(tmp_path) == expected and (tmp_path / "albedo.png").is_dir()


def begun_by(process: psutil.Process, out: Path, kind: str, later: float = 0.0) -> Path:
    """A folder with a result in it, as a process leaves it in `out`; or one of its number that began `later`."""
    token = f"{process.pid}-{int(process.create_time() + later)}"
    folder = out / f".{kind}-{token}"
    own_folders.make(folder, token)
    for name, text in RESULT.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("kind", ["partial", "whole"])
def test_what_a_living_process_has_begun_nobody_else_touches(tmp_path, kind):
    expected, first = former(tmp_path), psutil.Process(os.getppid())
    folder = begun_by(first, tmp_path, kind)
    with pytest.raises(BadInput, match=rf"another run \(process {first.pid}\) is at work here"):
        result_folder.stage(tmp_path, NAMES)
    result_folder.abandon(tmp_path)  # by the refused one, or by the guard of one that died
    assert content(tmp_path) == expected and content(folder).items() >= RESULT.items()
    assert list(tmp_path.glob(".*")) == [folder]


@posix
@pytest.mark.parametrize("later", [0.0, 1000.0])
def test_the_dead_are_in_nobodys_way(tmp_path, later):
    """A process that ended but was not waited for, and a living one that was given a dead one's number."""
    with subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE) as ended:
        assert ended.stdout is not None
        ended.stdout.read()
        process = psutil.Process(os.getppid() if later else ended.pid)
        begun_by(process, tmp_path, "partial", later)
        until = time.monotonic() + 10.0
        while alive(process) and not later and time.monotonic() < until:
            time.sleep(0.01)
        staging = result_folder.stage(tmp_path, NAMES)
        assert list(tmp_path.iterdir()) == [staging] and list(content(staging)) == [own_folders.MARKER]


#: A run that is told when to end.
FIRST = """
import sys
from pathlib import Path
from dante_w.contract.protocol import Step
from dante_w.run import own_folders, result_folder, scratch
out = Path(sys.argv[1])
names = ("albedo.png", "coverage.png", "report.json")
staging = result_folder.stage(out, names)
print("at work", flush=True)
report = sys.stdin.read()
for name in names:
    (staging / name).write_text(report if name == "report.json" else "new")
result_folder.publish(out)
"""


def test_a_second_run_into_one_folder_is_refused_and_the_first_ends_well(scene, tmp_path, capsys):
    out = tmp_path / "out"
    expected = former(out)
    own_folders.make(out / ".resume", "the former run's inputs")
    checkpoints = content(out / ".resume")
    command = [sys.executable, "-c", FIRST, str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdin is not None and first.stdout is not None
        assert first.stdout.readline() == "at work\n"
        for options in (["recover", "--resume"], ["average"]):
            assert main([*options, str(scene), "--out", str(out), "--json"]) == 2
            said = json.loads(capsys.readouterr().out.splitlines()[-1])
            assert (said["code"], str(first.pid) in said["message"]) == (2, True)
        assert content(out) == expected and content(out / ".resume") == checkpoints
        first.stdin.write(report("new"))
        first.stdin.close()
        assert first.wait() == 0
    assert content(out) == RESULT and len(list(out.iterdir())) == 3


def test_scratch_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for name in (f"dante-w-{dead.pid}-x", f"dante-w-{os.getppid()}-x", "dante-w-addon"):
        (tmp_path / name).mkdir()
    (tmp_path / f"dante-w-{dead.pid}-y").mkdir()
    (tmp_path / f"dante-w-{dead.pid}-y" / "precious").write_text("of somebody else")
    own_folders.make(tmp_path / f"dante-w-{dead.pid}-z", str(dead.pid))
    own = scratch.scratch()
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {own.name, f"dante-w-{os.getppid()}-x", f"dante-w-{dead.pid}-y", "dante-w-addon"}
    scratch.discard(os.getpid())
    assert not own.exists()


MEMORY = [
    MemoryError(),
    torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB."),
    RuntimeError(
        "[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can not allocate memory: you tried"
    ),
    RuntimeError("can't start new thread"),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    ImportError("libtorch_cpu.so: failed to map segment from shared object"),
]


@pytest.mark.parametrize("error", MEMORY, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("wrapped", [False, True])
def test_memory_that_ran_out_is_told_from_a_bug(capsys, error, wrapped):
    if wrapped:
        try:
            raise ValueError("a library failed") from error
        except ValueError as outer:
            error = outer
    assert job._explain(True, error) == 4
    said = capsys.readouterr()
    assert "memory" in json.loads(said.out)["message"] and "Traceback" not in said.err
    assert job._explain(True, ValueError("something else")) == 1


def test_whoever_stops_reading_cancels(monkeypatch):
    class Gone:
        def write(self, _):
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr(sys, "stdout", Gone())
    with pytest.raises(Cancelled):
        Progress(True).say(Step("scene", 0, 1))
    assert job.fail(True, 3, "Cancelled.") == 3


def test_a_mapped_file_takes_its_room_at_once(tmp_path):
    made = stages._mapped(tmp_path / "raw", float, (1000, 3))
    assert made.shape == (1000, 3) and not made.any()
    if hasattr(os, "posix_fallocate"):
        assert (tmp_path / "raw").stat().st_blocks * 512 >= 24_000


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("only root can mount a small disk, on Linux")
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder], check=False).returncode:
        pytest.skip("nothing can be mounted here")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_a_mapped_file_that_does_not_fit_is_a_full_disk(small_disk, capsys):
    with pytest.raises(OSError) as caught:
        stages._mapped(small_disk / "raw", float, (1000, 30))
    assert job._explain(True, caught.value) == 4
    assert "disk is full" in capsys.readouterr().out


@posix
def test_too_little_memory_to_begin_with_is_said(scene, tmp_path):
    resource = pytest.importorskip("resource")
    limit = 300 << 20
    done = subprocess.run(
        [sys.executable, "-m", "dante_w", "recover", scene, "--out", tmp_path / "out", "--json"],
        capture_output=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    if sys.platform == "darwin" and done.returncode == 0:
        pytest.skip("macOS does not heed the limit")
    assert done.returncode == 4
    assert "memory" in json.loads(done.stdout.splitlines()[-1])["message"]
    assert not (tmp_path / "out").exists()


def alive(process: psutil.Process) -> bool:
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


#: Stands in for Blender: starts the command with a pipe to itself.
PARENT = (
    "import subprocess, sys\n"
    "work = subprocess.Popen(sys.argv[1:], stdout=subprocess.PIPE, text=True, start_new_session=True)\n"
    "for line in work.stdout: print(line, end='', flush=True)\n"
)


@posix
@pytest.mark.parametrize("whom", ["work", "guard", "parent"])
def test_kill_9_leaves_no_process_and_nothing_behind(scene, tmp_path, whom):
    out = tmp_path / "out"
    expected = former(out)
    command = [sys.executable, "-m", "dante_w", "recover", str(scene), "--out", str(out), "--json"]
    command += ["--preset", "paper", "--irradiance", "field"]
    if whom == "parent":
        command = [sys.executable, "-c", PARENT, *command]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if json.loads(line)["stage"] == "rays":
                break
        first = psutil.Process(process.pid)
        family = [first, *first.children(recursive=True)]
        assert len(family) == (3 if whom == "parent" else 2)
        (family[-1] if whom == "work" else first).kill()
        until = time.monotonic() + 10.0
        while any(alive(each) for each in family):
            if time.monotonic() > until:
                for each in filter(alive, family):
                    each.kill()
                pytest.fail("a process lives on")
            time.sleep(0.05)
        rest = process.stdout.read().splitlines()
        code = process.wait()
    assert content(out) == expected and len(list(out.iterdir())) == 3
    if whom == "work":
        said = json.loads(rest[-1])
        assert (code, said["code"]) == (4, 4) and "memory" in said["message"]
    else:
        assert code == -signal.SIGKILL


@posix
def test_a_closed_terminal_stays_ignored_under_nohup(scene, tmp_path, capsys):
    former_handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        assert main(["average", str(scene), "--out", str(tmp_path / "out"), "--texture-size", "16"]) == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, former_handler)
