"""The product's command, run so that things go wrong: processes, and what a fault may leave behind."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from extremes.row import Row
from extremes.world import make, write

SIZE = ("--texture-size", "64")
MODELS = {"traced": ("--irradiance", "traced"), "field": ("--irradiance", "field")}
#: The command stops itself at a stage as if struck by kill -9, or works with other constants: Python put before it.
PATCHED = "import os, signal, sys; from dante_w.commands import cli\n{patch}\nsys.exit(cli.main())"


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code, its JSON lines, the log."""

    code: int
    events: list[dict[str, Any]]
    log: str

    @property
    def last(self) -> dict[str, Any]:
        return self.events[-1] if self.events else {}

    @property
    def sentence(self) -> str:
        """The error's, or nothing."""
        return str(self.last.get("message", "")) if self.last.get("stage") == "error" else ""


def command(*arguments: str | Path, patch: str | None = None) -> list[str]:
    """`dante-w ARGUMENTS --json`; with a patch, in one process without the guard."""
    start = ["-m", "dante_w"] if patch is None else ["-c", PATCHED.format(patch=patch)]
    return [sys.executable, *start, *map(str, arguments), "--json"]


def run(
    *arguments: str | Path, patch: str | None = None, before: list[str] | None = None, **changes: Any
) -> Ended:
    """Run it to its end; `before` are words before the command, `changes` go to the process's environment."""
    done = subprocess.run(
        [*(before or []), *command(*arguments, patch=patch)],
        capture_output=True, encoding="utf-8", errors="replace", check=False, timeout=600,
        env={**os.environ, **changes},
    )  # fmt: skip
    return ended(done.returncode, done.stdout, done.stderr)


def ended(code: int, said: str, log: str = "") -> Ended:
    events = []
    for line in said.splitlines():
        with contextlib.suppress(ValueError):
            events.append(json.loads(line))
    return Ended(code, events, log)


def started(*arguments: str | Path, patch: str | None = None) -> subprocess.Popen[str]:
    """Start it in a process group of its own, as the add-on does."""
    return subprocess.Popen(
        command(*arguments, patch=patch),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        encoding="utf-8", start_new_session=True,
    )  # fmt: skip


def wait_for(process: subprocess.Popen[str], stage: str, step: float = 0.0) -> bool:
    """Read its lines until `stage` has come so far; False if it ended before."""
    for line in process.stdout or ():
        event = json.loads(line)
        if event["stage"] == stage and event.get("step", 0) >= step:
            return True
    return False


def family(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """A process and all below it."""
    first = psutil.Process(process.pid)
    return [first, *first.children(recursive=True)]


def gone(processes: list[psutil.Process], seconds: float = 5.0) -> bool:
    """Whether all have ended within that time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(
            each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in _living(processes)
        ):
            return True
        time.sleep(0.02)
    return False


def _living(processes: list[psutil.Process]) -> Iterator[psutil.Process]:
    for each in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            each.status()
            yield each


@contextlib.contextmanager
def stand() -> Iterator[Stand]:
    """A scene folder and a former result beside it, in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="faults-") as temporary:
        folder = Path(temporary)
        write(make(), folder / "scene")
        done = run("average", folder / "scene", "--out", folder / "former", *SIZE)
        if done.code:
            raise RuntimeError(f"the unspoilt scene fails: {done.sentence}")
        yield Stand(folder)


@dataclass(frozen=True)
class Stand:
    """Where faults are provoked: `scene`, `former` (a whole result), and `out`, a copy of it for each fault."""

    folder: Path

    @property
    def scene(self) -> Path:
        return self.folder / "scene"

    @property
    def out(self) -> Path:
        return self.folder / "out"

    def fresh(self, where: Path | None = None) -> Path:
        """The former result, copied anew."""
        out = where or self.out
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(self.folder / "former", out)
        return out

    def scene_copy(self, name: str) -> Path:
        """The scene folder, copied to be spoilt."""
        copy = self.folder / name
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(self.scene, copy)
        return copy

    def short(self, sentence: str) -> str:
        """A sentence without this folder's path, which is another one each time."""
        return sentence.replace(f"{self.folder}{os.sep}", "")

    def left(self, where: Path | None = None) -> tuple[bool, list[str]]:
        """Whether the former result is there byte for byte, and what else is, without its owner's number."""
        out, former = where or self.out, self.folder / "former"
        names = {path.name for path in former.iterdir()}
        same = all(
            (out / name).is_file() and (out / name).read_bytes() == (former / name).read_bytes()
            for name in names
        )
        return same, sorted({path.name.partition("-")[0] for path in out.iterdir()} - names)


def judged(
    name: str, code: int, found: Ended, place: Stand, words: str = "", where: Path | None = None
) -> Row:
    """The row of a fault that has to end with `code` and a sentence that holds `words`, the former result untouched.

    After 20 seconds of work checkpoints are kept for `--resume`, whatever ends the run.
    """
    same, left = place.left(where)
    sentence = found.sentence
    told = f"exit {found.code}, former result {'intact' if same else 'CHANGED'}, {', '.join(left) or 'nothing'} left"
    good = found.code == code and same and set(left) <= {".resume"}
    said = bool(sentence) and words in sentence and "\n" not in sentence and "Traceback" not in found.log
    bound = f"exit {code}, one sentence, intact, nothing left"
    return Row(name, "faults", told, bound, good and said, place.short(sentence))


def failed(name: str, error: BaseException) -> Row:
    return Row(name, "faults", "not provoked", "provoked", False, f"{type(error).__name__}: {error}")


def tried(name: str, work: Callable[[], Row]) -> Row:
    """The row, also where the provocation itself fails."""
    try:
        return work()
    except Exception as error:
        return failed(name, error)
