#!/usr/bin/env python3
"""Make the environments and run things in them: `python3 dev.py demo | test | bench NAME | env`.

Needs nothing but the standard library of Python 3.8 or newer. Every environment is a virtual
environment beside this file, made from pinned versions the first time something asks for it:

    .venv           the backend: torch, numba, numpy, ... (Python 3.11 to 3.13)
    .venv-bench     the backend and what only benchmarks/ needs
    .venv-bpy-4.5   Blender 4.5 LTS as a module           (Python 3.11)
    .venv-bpy-5.2   Blender 5.2 LTS as a module           (Python 3.13)
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent
CPU_TORCH_INDEX = "https://download.pytorch.org/whl/cpu"


class Environment(NamedTuple):
    """A virtual environment: where it lies, the Pythons it may have, and what is installed in it."""

    name: str
    pythons: tuple[str, ...]
    requirements: tuple[str, ...]
    without_dependencies: tuple[str, ...] = ()
    editable: str = ""

    @property
    def python(self) -> Path:
        folder = ROOT / self.name
        return folder / "Scripts/python.exe" if os.name == "nt" else folder / "bin/python"


BACKEND = Environment(
    ".venv",
    ("3.11", "3.12", "3.13"),
    ("backend/requirements.txt", "backend/requirements-dev.txt"),
    editable="backend",
)
BENCH = Environment(
    ".venv-bench",
    BACKEND.pythons,
    ("backend/requirements.txt", "benchmarks/requirements.txt"),
    without_dependencies=("benchmarks/requirements-no-deps.txt",),
    editable="backend",
)
BPY_45 = Environment(".venv-bpy-4.5", ("3.11",), ("blender_tests/requirements-4.5.txt",))
BPY_52 = Environment(".venv-bpy-5.2", ("3.13",), ("blender_tests/requirements-5.2.txt",))


class Unavailable(Exception):
    """An environment cannot be made here; the message says what to install."""


# --- environments -------------------------------------------------------------------------------


def make(environment: Environment) -> Path:
    """Make `environment` unless its stamp says that it is whole and up to date; returns its Python."""
    python = find_python(environment.pythons)
    lists = environment.requirements + environment.without_dependencies
    sources = [f"{environment.editable}/pyproject.toml"] if environment.editable else []  # names the commands
    pins = "".join((ROOT / name).read_text(encoding="utf-8") for name in (*lists, *sources))
    stamp = ROOT / environment.name / "dev-stamp.txt"
    wanted = hashlib.sha256(f"{version(python)}\n{pins}".encode()).hexdigest()
    if stamp.is_file() and stamp.read_text() == wanted and environment.python.exists():
        return environment.python

    say(f"{environment.name}: new, Python {version(python)}")
    run([*python, "-m", "venv", "--clear", str(ROOT / environment.name)])
    pip = [str(environment.python), "-m", "pip", "--disable-pip-version-check", "install", "-qq"]
    say(f"{environment.name}: installing {', '.join(lists)}")
    files = [part for name in environment.requirements for part in ("-r", name)]
    run([*pip, *(torch_options() if environment.editable else []), *files])
    for name in environment.without_dependencies:
        run([*pip, "--no-deps", "-r", name])
    if environment.editable:
        run([*pip, "--no-build-isolation", "--no-deps", "-e", environment.editable])
    stamp.write_text(wanted)  # last: an environment without a stamp is not whole
    return environment.python


def find_python(versions: tuple[str, ...]) -> list[str]:
    """The command of the first Python found that has one of `versions` and can make environments."""
    for wanted in versions:
        for command in candidates(wanted):
            if version(command)[: len(wanted) + 1] == wanted + ".":
                return command
    raise Unavailable(f"no Python {' or '.join(versions)} found; install one (python.org, pyenv or uv).")


def candidates(wanted: str) -> Iterator[list[str]]:
    """Commands that may start Python `wanted`: this one, PATH, Windows' launcher, pyenv's and uv's."""
    yield [sys.executable]
    for name in (f"python{wanted}", "python3", "python"):
        if shutil.which(name):
            yield [name]
    if shutil.which("py"):
        yield ["py", f"-{wanted}"]
    if shutil.which("pyenv"):
        root = Path(output(["pyenv", "root"]) or os.devnull)
        for prefix in sorted(root.glob(f"versions/{wanted}.*"), reverse=True):
            yield [str(prefix / "bin/python")]
    if shutil.which("uv"):
        found = output(["uv", "python", "find", "--no-project", wanted])
        if found:
            yield [found]


def version(command: list[str]) -> str:
    """`3.11.7` for a Python that runs and can make environments, otherwise nothing."""
    return output([*command, "-c", "import ensurepip, platform, venv; print(platform.python_version())"])


def torch_options() -> list[str]:
    """PyPI's torch for Linux brings gigabytes of CUDA; without an NVIDIA GPU prefer PyTorch's CPU index."""
    if platform.system() != "Linux" or shutil.which("nvidia-smi"):
        return []
    try:
        urllib.request.urlopen(CPU_TORCH_INDEX + "/torch/", timeout=3).close()
    except OSError:
        return []
    return ["--extra-index-url", CPU_TORCH_INDEX]


def make_bpy() -> Path:
    """The Python of whichever Blender can be installed here, the older LTS first."""
    try:
        return make(BPY_45)
    except Unavailable:
        return make(BPY_52)


# --- commands -----------------------------------------------------------------------------------


def env() -> int:
    """Make every environment."""
    for environment in (BACKEND, BENCH, BPY_45, BPY_52):
        say(f"{environment.name} is ready: {make(environment)}")
    return 0


def bench(name: str, options: list[str], environment: Environment = BENCH) -> int:
    """Run `benchmarks/NAME.py` in the benchmarks' environment; its Cycles parts find Blender."""
    script = ROOT / "benchmarks" / f"{name}.py"
    if not script.is_file():
        raise Unavailable(f"there is no {script.relative_to(ROOT)}.")
    python, bpy_python = make(environment), make_bpy()
    child = {**child_environment(), "DANTEW_BPY_PYTHON": str(bpy_python)}
    return subprocess.call([str(python), str(script), *options], env=child)


def test(fast: bool, options: list[str]) -> int:
    """Lint, types, and all tests: everything that CI runs. `options` go to pytest.

    Two lanes of parts run side by side: most tests keep one core busy.
    """
    python = str(make(BACKEND))
    child = {**child_environment(), "DANTEW_BACKEND_PYTHON": python}
    pytest_options = [*(["-m", "not slow"] if fast else []), *options]
    backend = [
        Part("ruff check", [python, "-m", "ruff", "check", "."], ROOT),
        Part("ruff format", [python, "-m", "ruff", "format", "--check", "."], ROOT),
        Part("mypy", [python, "-m", "mypy"], ROOT / "backend"),
        Part("backend", [python, "-m", "pytest", *pytest_options], ROOT / "backend"),
    ]
    others = [Part("benchmarks", [str(make(BENCH)), "-m", "pytest", *pytest_options], ROOT / "benchmarks")]
    results = []
    for environment, name in ((BPY_45, "bpy 4.5"), (BPY_52, "bpy 5.2")):
        try:
            bpy_python = str(make(environment))
        except Unavailable as error:
            say(f"WARNING: {name} tests not run: {error}")
            results.append(Result(name, 0, 1 if os.environ.get("CI") == "true" else 0, 0.0))
            continue
        tests = [bpy_python, "-m", "pytest", "-q", "blender_tests", *pytest_options]
        others.append(Part(name, tests, ROOT))
    with ThreadPoolExecutor(2) as lanes:
        for lane in lanes.map(
            lambda parts: [part.run(child, bool(options)) for part in parts], (backend, others)
        ):
            results += lane

    print(f"\n{'part':<12} {'passed':>7} {'failed':>7} {'seconds':>8}")
    for result in results:
        print(f"{result.name:<12} {result.passed:>7} {result.failed:>7} {result.seconds:>8.1f}")
    failed = sum(result.failed for result in results)
    print(f"{sum(result.passed for result in results)} passed, {failed} failed")
    return 1 if failed else 0


class Result(NamedTuple):
    """What one part of the tests came to. A linter that is content counts as no test at all."""

    name: str
    passed: int
    failed: int
    seconds: float


class Part(NamedTuple):
    """One command of the test run."""

    name: str
    command: list[str]
    folder: Path

    def run(self, env: dict[str, str], selected: bool) -> Result:
        """Run it and show its output when it has ended; `selected` allows that no test matched the given options."""
        say(f"{self.name} runs")
        start = time.monotonic()
        done = subprocess.run(
            self.command,
            cwd=self.folder,
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
        )
        print(f"== {self.name}\n{done.stdout}", end="", flush=True)
        code, last = done.returncode, summary_of(done.stdout)
        passed, failed = counts(last) if "pytest" in self.command else (0, 0)
        nothing_matched = selected and code == 5
        if code and not failed and not nothing_matched:
            failed = 1
        return Result(self.name, passed, failed, time.monotonic() - start)


def summary_of(output: str) -> str:
    """pytest's last line."""
    return next((line for line in reversed(output.splitlines()) if re.search(r" in [\d.]+s", line)), "")


def counts(summary: str) -> tuple[int, int]:
    """(passed, failed or in error) of pytest's last line."""
    found = {word.rstrip("s"): int(n) for n, word in re.findall(r"(\d+) (passed|failed|errors?)", summary)}
    return found.get("passed", 0), found.get("failed", 0) + found.get("error", 0)


# --- small things -------------------------------------------------------------------------------


def say(text: str) -> None:
    print(f"== {text}", flush=True)


def run(command: list[str]) -> None:
    subprocess.run(command, cwd=ROOT, check=True, env=child_environment())


def output(command: list[str]) -> str:
    """What `command` prints, or nothing when it fails."""
    try:
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, encoding="utf-8", timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def child_environment() -> dict[str, str]:
    """This environment without what would lead another Python astray."""
    leave_out = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__")
    return {key: value for key, value in os.environ.items() if key not in leave_out}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True, metavar="demo | test | bench | env")
    commands.add_parser("demo", help="render a scene, recover its albedo, relight it: one picture")
    tests = commands.add_parser("test", help="everything CI runs; further options go to pytest")
    tests.add_argument("--fast", action="store_true", help="leave out what is marked slow")
    benches = commands.add_parser("bench", help="run benchmarks/NAME.py with the options that follow")
    benches.add_argument("name", metavar="NAME")
    benches.add_argument("rest", nargs=argparse.REMAINDER, metavar="...")
    commands.add_parser("env", help="make every environment")
    arguments, rest = parser.parse_known_args()  # what is left over belongs to the command
    try:
        if arguments.command == "test":
            return test(arguments.fast, rest)
        if arguments.command == "bench":
            return bench(arguments.name, arguments.rest)
        if arguments.command == "demo":
            return bench("demo", rest, BACKEND)
        return env()
    except Unavailable as error:
        say(f"stopped: {error}")
    except subprocess.CalledProcessError as error:
        say(f"stopped: {' '.join(error.cmd)} ended with {error.returncode}")
    except KeyboardInterrupt:
        say("stopped")
    return 1


if __name__ == "__main__":
    sys.exit(main())
