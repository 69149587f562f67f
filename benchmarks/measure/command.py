"""Run the product's own command line and the scripts that need Blender, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
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


def blender(script: str, arguments: list[str]) -> None:
    """Run benchmarks/cycles/SCRIPT in the environment with bpy that DANTEW_BPY_PYTHON names (dev.py sets it)."""
    python = os.environ.get("DANTEW_BPY_PYTHON")
    if not python:
        sys.exit("DANTEW_BPY_PYTHON names no Python with bpy; start this with `python3 dev.py bench NAME`.")
    code = subprocess.call([python, str(ROOT / "benchmarks" / "cycles" / script), *arguments])
    if code:
        sys.exit(f"benchmarks/cycles/{script} ended with {code}")
