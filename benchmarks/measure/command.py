"""Run the product's own command line and the scripts that need Blender, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def dante_w(arguments: list[str], out: Path) -> tuple[dict[str, Any], float]:
    """Run `dante-w ARGUMENTS --out OUT`; returns its report and the seconds it took."""
    start = time.monotonic()
    command = [sys.executable, "-m", "dante_w", *arguments, "--out", str(out), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8")
    last: dict[str, Any] = {"stage": "error", "message": "ended without a word"}
    for line in process.stdout or ():
        message = json.loads(line)
        if message["stage"] != last["stage"]:
            print(f"   {message['stage']}", file=sys.stderr, flush=True)
        last = message
    if process.wait() or last["stage"] != "done":
        sys.exit(f"dante-w {' '.join(arguments)}: {last.get('message', 'broke off')}")
    return last["report"], time.monotonic() - start


class ScriptFailed(Exception):
    """A script in benchmarks/cycles/ did not end well; the message is the last thing it said."""


def blender_lines(script: str, arguments: list[str]) -> Iterator[str]:
    """As `blender`, yielding each line that the script prints; `ScriptFailed` at its end if it failed."""
    command = [blender_python(), str(ROOT / "benchmarks" / "cycles" / script), *arguments]
    last = ""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8", errors="replace"
    )
    try:
        for line in process.stdout or ():
            last = line.strip() or last
            yield line.rstrip("\n")
    finally:  # also when the caller stops early: no render goes on unseen
        if process.poll() is None and process.stdout:
            process.stdout.close()
        code = process.wait()
    if code:
        raise ScriptFailed(last or f"{script} ended with {code}")


def blender(script: str, arguments: list[str]) -> None:
    """Run benchmarks/cycles/SCRIPT in the environment with bpy that DANTEW_BPY_PYTHON names (dev.py sets it)."""
    code = subprocess.call([blender_python(), str(ROOT / "benchmarks" / "cycles" / script), *arguments])
    if code:
        sys.exit(f"benchmarks/cycles/{script} ended with {code}")


def blender_python() -> str:
    python = os.environ.get("DANTEW_BPY_PYTHON")
    if not python:
        sys.exit("DANTEW_BPY_PYTHON names no Python with bpy; start this with `python3 dev.py bench NAME`.")
    return python
