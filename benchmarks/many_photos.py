"""Memory and time against the number of photos: `python3 dev.py bench many_photos [--photos 250 1000 2500] [--size 128]`.

A made scene of so many small photos, each from a place of its own and under one of five lights, recovered by both models, each run
in a fresh process with its ray cache in files, as a scene that is large for its machine has it. Anonymous memory, what the
process cannot give back, and all that it held are noted by stage; and what the same scene would take with photos of 24 megapixels.
Writes the tables of docs/benchmarks.md to OUT/scale.md and all figures to OUT/scale.json; runs that this has already are not done again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil
from dante_w.contract.scene_folder import Scene, write_scene
from dante_w.rays.ray_cache import sample_bytes
from dante_w.scene.mesh import write_obj
from measure.command import ROOT
from measure.machine import provenance, sentence
from measure.synthetic_scene import bumpy_sphere, write_photos

LIGHTS = 5
MESH_ROWS = 160  # 101,760 triangles
MODELS = {"traced light": [], "the paper's model": ["--irradiance", "field"]}
PRESETS = ("draft", "standard")
#: Looks at the process a second, and megapixels of the photos that the arithmetic is for.
LOOKS, FULL_SIZE = 20, 24.0
#: Stages whose seconds grow with pixels.
GROWING = ("rays", "albedo")
GIB = 2.0**30


@dataclass(frozen=True)
class Run:
    """What one `dante-w recover` took: seconds by stage and in all; most bytes by stage, of anonymous memory and of all that was
    resident, mapped files included; bytes of the ray cache's files; `held_out_psnr` in dB."""

    photos: int
    model: str
    preset: str
    samples: int
    seconds: dict[str, float]
    total_seconds: float
    anonymous: dict[str, int]
    resident: dict[str, int]
    cache_file_bytes: int
    held_out_psnr: float | None


def main() -> None:
    options = parse()
    out = options.out.resolve()
    scene = out / "scene"
    content = {
        "measured": provenance(),
        "size": options.size,
        "texture_size": options.texture_size,
        "runs": [],
    }
    if (out / "scale.json").is_file():
        former = json.loads((out / "scale.json").read_text(encoding="utf-8"))
        if all(former.get(name) == content[name] for name in ("size", "texture_size")):
            content = former
    runs = [Run(**run) for run in content["runs"]]
    mesh = bumpy_sphere(MESH_ROWS)
    most = max(options.photos)
    print(f"== {most} photos of {options.size} x {options.size}", file=sys.stderr, flush=True)
    frames = write_photos(scene, mesh, options.size, most, LIGHTS)
    write_obj(scene / "mesh.obj", mesh)
    for count in sorted(options.photos):
        chosen = [frames[(2 * i + 1) * most // (2 * count)] for i in range(count)]
        write_scene(scene, Scene(scene / "transforms.json", scene / "mesh.obj", chosen))
        for model, arguments in MODELS.items():
            for preset in options.presets:
                if any((run.photos, run.model, run.preset) == (count, model, preset) for run in runs):
                    continue
                print(f"== {count} photos, {model}, {preset}", file=sys.stderr, flush=True)
                arguments_all = [*arguments, "--preset", preset, "--texture-size", str(options.texture_size)]
                runs.append(recover(count, model, preset, scene, arguments_all, out / "result"))
                content["runs"] = [asdict(run) for run in runs]
                (out / "scale.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    text = report(runs, options.size, options.texture_size, content["measured"])
    (out / "scale.md").write_text(text, encoding="utf-8")
    shutil.rmtree(scene)
    shutil.rmtree(out / "result", ignore_errors=True)
    print(text)
    if options.json:
        print(json.dumps(content))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--photos", type=int, nargs="+", default=[250, 1000, 2500])
    parser.add_argument("--size", type=int, default=128, help="pixels along a photo's side")
    parser.add_argument("--texture-size", type=int, default=2048)
    parser.add_argument("--presets", nargs="+", default=list(PRESETS), choices=PRESETS)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "many_photos")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def recover(photos: int, model: str, preset: str, scene: Path, arguments: Sequence[str], result: Path) -> Run:
    """Run the product with its ray cache in files."""
    variant = ROOT / "benchmarks" / "methods" / "variant.py"
    command = [
        sys.executable,
        str(variant),
        '{"cast.share_of_memory": 0.0}',
        "recover",
        str(scene),
        *arguments,
    ]
    began = time.monotonic()
    process = subprocess.Popen(
        [*command, "--out", str(result), "--json"], stdout=subprocess.PIPE, encoding="utf-8"
    )
    stage = ["start"]
    last: dict = {}
    with watched(process.pid, stage, result) as (anonymous, resident, files):
        for line in process.stdout or ():
            last = json.loads(line)
            if last["stage"] not in (stage[0], "expected", "planned", "done"):
                stage[0] = last["stage"]
                print(f"   {stage[0]}", file=sys.stderr, flush=True)
    if process.wait() or last.get("stage") != "done":
        sys.exit(f"{' '.join(command)}: {last.get('message', 'broke off')}")
    done = last["report"]
    total = time.monotonic() - began
    return Run(
        photos,
        model,
        preset,
        done["samples"],
        done["seconds"],
        total,
        anonymous,
        resident,
        max(files),
        done["held_out_psnr"],
    )


@contextmanager
def watched(
    process: int, stage: list[str], result: Path
) -> Iterator[tuple[dict[str, int], dict[str, int], list[int]]]:
    """Most anonymous and resident bytes by `stage[0]`, and the bytes of the cache's files, looked at while a process runs."""
    anonymous: dict[str, int] = {}
    resident: dict[str, int] = {}
    files = [0]
    ended = threading.Event()

    def look() -> None:
        own = psutil.Process(process)
        while not ended.wait(1.0 / LOOKS):
            try:
                memory = own.memory_info()
                files.append(sum(file.stat().st_size for file in result.parent.glob("*/**/rays/*")))
            except (psutil.Error, FileNotFoundError):  # it ended, or removed a file just now
                continue
            for most, now in ((anonymous, memory.rss - memory.shared), (resident, memory.rss)):
                most[stage[0]] = max(most.get(stage[0], 0), now)

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        yield anonymous, resident, files
    finally:
        ended.set()
        watcher.join()


def report(runs: Sequence[Run], size: int, texture_size: int, facts: dict[str, object]) -> str:
    """All tables and the arithmetic, as Markdown."""
    largest = max(runs, key=lambda run: run.photos)
    parts = [
        f"{largest.photos} photos of {size} x {size} pixels at most, a texture of {texture_size} x {texture_size}; "
        f"the ray cache in files. {sentence(facts)}",
        run_table(runs),
        "Most anonymous memory by stage, GiB:",
        stage_table(runs),
        arithmetic(runs, size),
    ]
    return "\n\n".join(parts) + "\n"


def run_table(runs: Sequence[Run]) -> str:
    """A row a run."""
    lines = [
        "| model | preset | photos | samples (M) | seconds | anonymous memory (GiB) | all resident (GiB) | cache files (GiB) |"
        " held-out PSNR (dB) |",
        "|---|---|" + "---:|" * 7,
    ]
    for run in ordered(runs):
        score = "" if run.held_out_psnr is None else f"{run.held_out_psnr:.1f}"
        memory = [max(run.anonymous.values()), max(run.resident.values()), run.cache_file_bytes]
        cells = [
            f"{run.samples / 1e6:.1f}",
            f"{run.total_seconds:.0f}",
            *(f"{m / GIB:.2f}" for m in memory),
            score,
        ]
        lines.append(f"| {run.model} | `{run.preset}` | {run.photos} | {' | '.join(cells)} |")
    return "\n".join(lines)


def stage_table(runs: Sequence[Run]) -> str:
    """Anonymous memory by stage; empty where a model has no such stage."""
    stages = list(dict.fromkeys(stage for run in runs for stage in run.anonymous))
    lines = [f"| model | preset | photos | {' | '.join(stages)} |", "|---|---|---:|" + "---:|" * len(stages)]
    for run in ordered(runs):
        cells = [f"{run.anonymous[s] / GIB:.2f}" if s in run.anonymous else "" for s in stages]
        lines.append(f"| {run.model} | `{run.preset}` | {run.photos} | {' | '.join(cells)} |")
    return "\n".join(lines)


def ordered(runs: Sequence[Run]) -> list[Run]:
    return sorted(runs, key=lambda run: (list(MODELS).index(run.model), run.preset, run.photos))


def arithmetic(runs: Sequence[Run], size: int) -> str:
    """What as many photos of `FULL_SIZE` megapixels would take."""
    lines = [
        f"With photos of {FULL_SIZE:g} megapixels, of which as large a part shows the mesh; seconds of {' and '.join(GROWING)} "
        "grow with pixels, the others stay:",
        "",
        f"| model | preset | photos | samples (10^9) | cache files at {sample_bytes(False)} bytes a sample (GB) | hours |",
        "|---|---|" + "---:|" * 4,
    ]
    factor = FULL_SIZE * 1e6 / size**2
    for run in ordered(runs):
        if run.photos != max(each.photos for each in runs):
            continue
        grows = sum(run.seconds.get(stage, 0.0) for stage in GROWING)
        seconds = run.total_seconds + grows * (factor - 1.0)
        samples = run.samples * factor
        cells = f"{samples / 1e9:.1f} | {samples * sample_bytes(False) / 1e9:.0f} | {seconds / 3600.0:.1f}"
        lines.append(f"| {run.model} | `{run.preset}` | {run.photos} | {cells} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
