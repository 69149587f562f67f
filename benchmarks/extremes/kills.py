"""Kill -9: of the work, of the process that guards it, of all, of whoever started it, in every stage and while the result is put
into place; and runs that go on from there with `--resume`."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import psutil

from extremes.provoke import (
    MODELS,
    SIZE,
    Ended,
    Stand,
    command,
    ended,
    family,
    gone,
    judged,
    run,
    started,
    tried,
    wait_for,
)
from extremes.row import Row

STAGES = {
    "traced": ("scene", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"),
    "field": ("scene", "rays", "optimise", "held-out", "final pass", "bake", "write"),
}
RESUMED = {
    "traced": (("transfer", 0), ("plan", 0), ("lights", 1), ("write", 0)),
    "field": (("optimise", 0), ("optimise", 30), ("final pass", 1), ("write", 0)),
}
#: Runs that are killed at any moment.
AT_RANDOM = 10
#: What kill -9 may leave until the next run.
LEFTOVERS = {".partial", ".whole", ".doomed", ".resume"}
AT_STAGE = """
from dante_w.run.progress import Progress
update = Progress.update
def struck(self, stage, step, *more):
    if stage == {stage!r} and step >= {step}:
        os.kill(os.getpid(), signal.SIGKILL)
    update(self, stage, step, *more)
Progress.update = struck
"""
IN_PLACE = """
replace, done = os.replace, []
def struck(source, target):
    if '.whole' in str(source):
        if len(done) == {count}:
            os.kill(os.getpid(), signal.SIGKILL)
        done.append(target)
    replace(source, target)
os.replace = struck
"""
KEEP_ALL = "\nfrom dante_w.run import checkpoints; checkpoints.SECONDS = 0.0"
#: A stand-in for Blender: starts the command with a pipe to itself and passes on what it says.
PARENT = (
    "import subprocess, sys\n"
    "work = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, start_new_session=True)\n"
    "print(work.pid, flush=True)\n"
    "for line in work.stdout: print(line, end='', flush=True)\n"
)


def rows(place: Stand, progress: Callable[[str], None]) -> Iterator[Row]:
    for model, stages in STAGES.items():
        for stage in stages:
            name = f"kill -9 in stage {stage}, {model}"
            progress(name)
            yield tried(name, partial(_everything, place, name, model, stage))
        name = f"kill -9 at {AT_RANDOM} moments of a run, {model}"
        progress(name)
        yield tried(name, partial(_at_random, place, name, model))
    for whom, model, stage in (
        ("work", "traced", "transfer"),
        ("work", "field", "optimise"),
        ("guard", "traced", "lights"),
    ):
        name = f"kill -9 of the {whom} alone in stage {stage}"
        progress(name)
        yield tried(name, partial(_one, place, name, whom, model, stage))
    for model, stage in (("traced", "transfer"), ("field", "optimise")):
        name = f"kill -9 of who started it, in stage {stage}"
        progress(name)
        yield tried(name, partial(_parent, place, name, model, stage))
    for count in range(4):
        name = f"kill -9 while put into place, after {count} of 3 files"
        progress(name)
        yield tried(name, partial(_in_place, place, name, count))
    for model in STAGES:
        for stage, step in RESUMED[model]:
            name = f"--resume after kill -9 in stage {stage} from step {step}, {model}"
            progress(name)
            yield tried(name, partial(_resumed, place, name, model, stage, step))


def _arguments(place: Stand, model: str, out: Path | None = None) -> list[str | Path]:
    return ["recover", place.scene, "--out", out or place.out, "--preset", "draft", *SIZE, *MODELS[model]]


def _everything(place: Stand, name: str, model: str, stage: str) -> Row:
    """The process is struck at that very moment; whatever guards it would die as well."""
    place.fresh()
    ended_as = run(*_arguments(place, model), patch=AT_STAGE.format(stage=stage, step=0)).code
    assert ended_as == -signal.SIGKILL, f"it ended with {ended_as}"
    return _after_a_kill(place, name)


def _at_random(place: Stand, name: str, model: str) -> Row:
    """All processes of the command die at once, at moments spread over a run: the result is then the former or the new one."""
    began = time.monotonic()
    whole = _whole(place, model)
    seconds, ends = max(time.monotonic() - began, 4.0), []
    random = np.random.default_rng(0)
    for _ in range(AT_RANDOM):
        place.fresh()
        process = started(*_arguments(place, model))
        time.sleep(random.uniform(0.0, seconds))
        members = family(process)
        os.killpg(process.pid, signal.SIGKILL)
        assert gone(members), "a process lives on"
        run("average", place.folder / "nothing", "--out", place.out)  # fails, but puts things right first
        same, left = place.left()
        new = all(
            (place.out / own).read_bytes() == (whole / own).read_bytes()
            for own in ("albedo.png", "coverage.png")
        )
        ends.append(", ".join(left) if left else "former" if same else "new" if new else "MIXED")
    told = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(ends))
    return Row(name, "faults", told, "former or new, whole, nothing left", set(ends) <= {"former", "new"})


def _after_a_kill(place: Stand, name: str) -> Row:
    """The former result must stand, and the next run must leave nothing of this one."""
    same, left = place.left()
    following = run("average", place.scene, "--out", place.out, *SIZE)
    _, left_then = place.left()
    told = f"former result {'intact' if same else 'CHANGED'}, {', '.join(left) or 'nothing'} left; "
    told += f"next run exit {following.code}, {', '.join(left_then) or 'nothing'} left"
    good = same and set(left) <= LEFTOVERS and following.code == 0 and not left_then
    return Row(name, "faults", told, "intact; next run works and leaves nothing", good, following.sentence)


def _one(place: Stand, name: str, whom: str, model: str, stage: str) -> Row:
    """One of the two processes dies. The work's death is told as what it is most likely; a dead guard ends the work."""
    place.fresh()
    process = started(*_arguments(place, model))
    assert wait_for(process, stage), "it ended before"
    members = family(process)
    members[-1 if whom == "work" else 0].kill()
    said = process.stdout.read() if process.stdout else ""
    ended_all = gone(members)
    found = ended(process.wait() if whom == "work" else 3, said)
    row = judged(name, 4 if whom == "work" else 3, found, place)
    return row if ended_all else row._replace(holds=False, note="a process lives on")


def _parent(place: Stand, name: str, model: str, stage: str) -> Row:
    """Blender crashes: the backend finds nobody listening."""
    place.fresh()
    process = subprocess.Popen(
        [sys.executable, "-c", PARENT, *command(*_arguments(place, model))],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, encoding="utf-8",
    )  # fmt: skip
    assert process.stdout is not None
    backend = psutil.Process(int(process.stdout.readline()))
    assert wait_for(process, stage), "it ended before"
    members = [backend, *backend.children(recursive=True)]
    process.kill()
    process.wait()
    ended_all = gone(members)
    same, left = place.left()
    told = f"{'no process' if ended_all else 'a process LIVES ON'} after 5 s, former result {'intact' if same else 'CHANGED'}, "
    told += f"{', '.join(left) or 'nothing'} left"
    return Row(
        name, "faults", told, "no process after 5 s, intact, nothing left", ended_all and same and not left
    )


def _in_place(place: Stand, name: str, count: int) -> Row:
    """Struck between the renames: the new result stands already, and the next run, even one that fails, completes it."""
    place.fresh()
    (place.out / "albedo.png").write_bytes(b"former")
    run("average", place.scene, "--out", place.out, *SIZE, patch=IN_PLACE.format(count=count))
    whole = (place.out / "report.json").exists()
    following = run("average", place.folder / "nothing", "--out", place.out)
    same = all(
        (place.out / own).read_bytes() == (place.folder / "former" / own).read_bytes()
        for own in ("albedo.png", "coverage.png")
    )
    _, left = place.left()
    told = f"report {'there' if whole else 'missing'} until the next run, then {'whole' if same else 'NOT WHOLE'}"
    good = same and not left and following.code == 2 and (place.out / "report.json").exists()
    return Row(
        name,
        "faults",
        f"{told}, {', '.join(left) or 'nothing'} left",
        "whole after the next run, nothing left",
        good,
    )


def _whole(place: Stand, model: str) -> Path:
    """The result of a run that nothing happens to."""
    whole = place.folder / f"whole-{model}"
    if not whole.exists():
        assert run(*_arguments(place, model, whole)).code == 0
    return whole


def _resumed(place: Stand, name: str, model: str, stage: str, step: int) -> Row:
    """The same bytes as without the kill, from what was kept."""
    whole, out = _whole(place, model), place.out
    shutil.rmtree(out, ignore_errors=True)
    run(*_arguments(place, model), patch=AT_STAGE.format(stage=stage, step=step) + KEEP_ALL)
    kept = sorted(path.name for path in (out / ".resume").iterdir() if path.is_dir())
    again: Ended = run(*_arguments(place, model), "--resume")
    used = again.last.get("report", {}).get("resumed", [])
    names = ("albedo.png", "coverage.png")
    same = again.code == 0 and all((out / own).read_bytes() == (whole / own).read_bytes() for own in names)
    left = sorted({path.name for path in out.iterdir()} - {*names, "report.json"})
    told = f"{'same bytes' if same else 'OTHER BYTES'}, used {', '.join(used) or 'nothing'}, {', '.join(left) or 'nothing'} left"
    good = same and sorted(used) == kept and bool(used) and not left
    return Row(name, "faults", told, "same bytes as without the kill, nothing left", good, again.sentence)
