"""The preset `draft` beside gradient-domain texturing: `python3 dev.py bench draft SCENE [--texture-size 1024] [--rounds 3]`.

`dante-w recover --preset draft` by both models and adobe-lagrange's texturing make a texture of one size from the same photos,
each in a fresh process from its start to its end, in turns. Prints seconds on the clock and of the processors, medians: the latter
hardly change when others use the machine, the former are what a user waits.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from measure.command import ROOT
from measure.machine import provenance, sentence

LAGRANGE = "adobe-lagrange"


@dataclass
class Times:
    """Seconds of each round, on the clock and of all processors."""

    clock: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)


def main() -> None:
    options = parse()
    facts = provenance()
    size, out = str(options.texture_size), options.out.resolve()
    scene = [str(options.scene)]
    if (options.scene / "mesh.obj").is_file():  # GigaLit's folders do not name their mesh
        scene += ["--mesh", str(options.scene / "mesh.obj")]
    product = [
        sys.executable,
        "-m",
        "dante_w",
        "recover",
        *scene,
        "--preset",
        "draft",
        "--texture-size",
        size,
    ]
    lagrange = [sys.executable, str(ROOT / "benchmarks" / "methods" / "lagrange_texturing.py"), *scene]
    commands = {
        "`draft`, traced light": [*product, "--out", str(out / "traced")],
        "`draft`, the paper's model": [*product, "--irradiance", "field", "--out", str(out / "field")],
        LAGRANGE: [*lagrange, "--texture-size", size, "--out", str(out / "lagrange")],
    }
    times = {name: Times() for name in commands}
    for turn in range(options.rounds + 1):  # the first one compiles kernels and fills the disk's cache
        for name, command in commands.items():
            print(f"   round {turn} of {options.rounds}: {name}", file=sys.stderr, flush=True)
            clock, processor = timed(command)
            if turn > 0:
                times[name].clock.append(clock)
                times[name].processor.append(processor)
    print(table(times, options.scene.name, options.texture_size))
    print(f"\nMedians of {options.rounds} rounds. {sentence(facts)}")
    if options.json:
        content = {
            "measured": facts,
            "scene": options.scene.name,
            "texture_size": options.texture_size,
            "clock_seconds": {name: own.clock for name, own in times.items()},
            "processor_seconds": {name: own.processor for name, own in times.items()},
        }
        print(json.dumps(content))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--texture-size", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "draft")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def timed(command: list[str]) -> tuple[float, float]:
    """Seconds that a command takes, on the clock and of the processors; ends the benchmark if it fails."""
    before, began = psutil.Process().cpu_times(), time.monotonic()
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    clock, after = time.monotonic() - began, psutil.Process().cpu_times()
    if done.returncode:
        sys.exit(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return clock, spent


def table(times: dict[str, Times], scene: str, size: int) -> str:
    """Seconds of each, and how much longer lagrange takes, as Markdown."""
    lines = [
        f"| {scene}, {size} x {size} texels | seconds | processor seconds | {LAGRANGE} takes so many times as long |",
        "|---|---:|---:|---:|",
    ]
    yardstick = statistics.median(times[LAGRANGE].clock)
    for name, own in times.items():
        clock, processor = statistics.median(own.clock), statistics.median(own.processor)
        lines.append(f"| {name} | {clock:.1f} | {processor:.1f} | {yardstick / clock:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
