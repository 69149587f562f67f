"""Cost against the size of the scene: `python3 dev.py bench scaling [--irradiance field] [--quick] [--out DIR]`.

Runs `dante-w recover` in a fresh process on synthetic scenes that grow in one way at a time: photos, pixels per photo,
texels. Prints seconds per stage, memory, and how fast each grows; writes scaling-IRRADIANCE.png and .json.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib
import numpy as np
from dante_w.contract.scene_folder import Frame
from dante_w.scene.mesh import Mesh
from measure.command import ROOT, dante_w
from measure.machine import provenance, sentence
from measure.synthetic_scene import bumpy_sphere, write_photos, write_scene_folder

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

#: What does not grow: photos where pixels or texels do, sides of photos and textures where others do.
PHOTOS, PHOTO_SIDE, TEXTURE_SIDE = 8, 512, 2048
#: Photo files of one size; scenes of more photos show them again.
DIFFERENT = 4
MESH_ROWS = 160  # 101,760 triangles
QUICK = {"photos": [10, 80], "megapixels": [0.25, 2.0], "texture_sizes": [512, 4096]}
#: From its start to its end a process does more than its stages say: imports, freeing memory.
END, TOTAL, MEMORY = "end", "all", "peak memory"
STAGES = (
    *("start", "scene", "rays"),
    *("transfer", "plan", "lights", "albedo"),
    *("optimise", "held-out", "final pass"),
    *("bake", "write", END),
)
COLOURS = (
    "#56B4E9",
    "#D55E00",
    "#0072B2",
    "#CC79A7",
    "#009E73",
    "#E69F00",
    "#8B5A2B",
    "#999999",
    "#F0E442",
    "#332288",
)  # Okabe, Ito, and one more
#: Between two looks at the ray cache's files.
LOOK_SECONDS = 1.0
#: A stage that never took this many seconds grows by chance.
NOTICEABLE = 0.25


@dataclass(frozen=True)
class Shape:
    """One scene of a ladder. size: of what grows, in the unit that the ladder's name says."""

    ladder: str
    size: float
    photos: int = PHOTOS
    photo_side: int = PHOTO_SIDE
    texture_side: int = TEXTURE_SIDE


@dataclass(frozen=True)
class Run:
    """What one `dante-w recover` took.

    seconds: per stage, and `END` and `TOTAL`. peak_memory_bytes: of the process, as its report has it; it counts
    pages of files that are mapped. cache_file_bytes: the ray cache where it went to disk, 0 where it stayed in memory.
    """

    shape: Shape
    samples: int
    seconds: dict[str, float]
    peak_memory_bytes: int
    cache_file_bytes: int

    def value(self, what: str) -> float:
        """Seconds of a stage (0 if there was none), or bytes of memory."""
        return self.peak_memory_bytes if what == MEMORY else self.seconds.get(what, 0.0)


def main() -> None:
    options = parse()
    out = options.out.resolve()
    scene, result = out / "scene", out / "result"
    mesh, frames, runs = bumpy_sphere(MESH_ROWS), {}, []
    facts = provenance()
    for shape in shapes(options):
        print(f"== {shape.size:g} {shape.ladder}", file=sys.stderr, flush=True)
        if shape.photo_side not in frames:
            frames[shape.photo_side] = write_photos(scene, mesh, shape.photo_side, DIFFERENT)
        runs.append(recover(shape, options, scene, mesh, frames[shape.photo_side], result))
        # after each run: an early end keeps what was measured
        content = {"measured": facts, "preset": options.preset, "runs": [asdict(run) for run in runs]}
        content["exponents"] = exponents(runs)
        name = f"scaling-{options.irradiance}"
        (out / f"{name}.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    shutil.rmtree(scene)
    shutil.rmtree(result)
    print(f"{run_table(runs)}\n\n{exponent_table(runs)}\n\nPreset {options.preset}. {sentence(facts)}")
    draw(out / f"{name}.png", runs)
    print(out / f"{name}.png")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--photos", type=int, nargs="+", default=[10, 40, 160, 640, 2500])
    parser.add_argument("--megapixels", type=float, nargs="+", default=[0.25, 1.0, 4.0, 12.0, 24.0])
    sides = [512, 1024, 2048, 4096, 8192, 16384]
    parser.add_argument("--texture-sizes", type=int, nargs="+", default=sides, help="texels along a side")
    parser.add_argument("--quick", action="store_true", help="two sizes of each, in about a minute")
    parser.add_argument("--irradiance", default="traced", choices=("traced", "field"))
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "scaling")
    options = parser.parse_args()
    if options.quick:
        vars(options).update(QUICK)
    return options


def shapes(options: argparse.Namespace) -> list[Shape]:
    """Every scene of the three ladders."""
    sides = {size: round(math.sqrt(size * 1e6)) for size in options.megapixels}
    return [
        *(Shape("photos", count, photos=count) for count in options.photos),
        *(Shape("megapixels per photo", size, photo_side=side) for size, side in sides.items()),
        *(Shape("megatexels", side**2 / 1e6, texture_side=side) for side in options.texture_sizes),
    ]


def recover(
    shape: Shape, options: argparse.Namespace, scene: Path, mesh: Mesh, frames: list[Frame], result: Path
) -> Run:
    """Run the product on a scene of this shape."""
    write_scene_folder(scene, mesh, frames, shape.photos)
    arguments = ["recover", str(scene), "--irradiance", options.irradiance, "--preset", options.preset]
    arguments += ["--texture-size", str(shape.texture_side)]
    with largest_cache_file(result) as cache_file:
        report, total = dante_w(arguments, result)
    seconds = {**report["seconds"], END: total - sum(report["seconds"].values()), TOTAL: total}
    return Run(shape, report["samples"], seconds, report["peak_memory_bytes"], max(cache_file))


@contextmanager
def largest_cache_file(result: Path) -> Iterator[list[int]]:
    """A list of the bytes that a run's ray cache had on disk, looked at again and again while the run goes on."""
    found, ended = [0], threading.Event()

    def look() -> None:
        while not ended.wait(LOOK_SECONDS):
            try:
                found.append(sum(file.stat().st_size for file in result.glob("*/rays/*")))
            except FileNotFoundError:  # the run removes them
                continue

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        yield found
    finally:
        ended.set()
        watcher.join()


def exponent(sizes: list[float], values: list[float]) -> float:
    """The p of value ~ size^p: least squares on logarithms over the larger half of the sizes, two at least."""
    order = np.argsort(sizes)[-max(math.ceil(len(sizes) / 2), 2) :]
    slope, _ = np.polyfit(np.log(np.array(sizes)[order]), np.log(np.array(values)[order]), 1)
    return float(slope)


def exponents(runs: list[Run]) -> dict[str, dict[str, float]]:
    """Per ladder the exponent of every stage that takes noticeable time, of the whole and of memory."""
    result: dict[str, dict[str, float]] = {}
    for ladder, own in by_ladder(runs).items():
        result[ladder] = {}
        for what in (*STAGES, TOTAL, MEMORY):
            known = [run for run in own if run.value(what) > 0.0]
            if len(known) > 1 and max(run.value(what) for run in known) >= NOTICEABLE:
                values = [run.value(what) for run in known]
                result[ladder][what] = round(exponent([run.shape.size for run in known], values), 2)
    return result


def stages(runs: list[Run]) -> list[str]:
    """Those of `STAGES` that runs have."""
    return [stage for stage in STAGES if any(stage in run.seconds for run in runs)]


def by_ladder(runs: list[Run]) -> dict[str, list[Run]]:
    ladders: dict[str, list[Run]] = {}
    for run in runs:
        ladders.setdefault(run.shape.ladder, []).append(run)
    return ladders


def run_table(runs: list[Run]) -> str:
    """Every run as a Markdown table: seconds, gigabytes, millions of samples."""
    names = [*stages(runs), TOTAL]
    lines = [
        f"| grows | size | samples (M) | {' | '.join(names)} | {MEMORY} (GB) | ray cache file (GB) |",
        "|---|" + "---:|" * (len(names) + 4),
    ]
    for run in runs:
        seconds = " | ".join(f"{run.value(stage):.2f}" for stage in names)
        memory = f"{run.peak_memory_bytes / 1e9:.2f} | {run.cache_file_bytes / 1e9:.2f}"
        name = f"{run.shape.ladder} | {run.shape.size:.4g}"
        lines.append(f"| {name} | {run.samples / 1e6:.1f} | {seconds} | {memory} |")
    return "\n".join(lines)


def exponent_table(runs: list[Run]) -> str:
    """Exponents as a Markdown table; empty where a stage takes no time to speak of."""
    names = [*stages(runs), TOTAL, MEMORY]
    lines = [
        f"| cost grows with size to the power of | {' | '.join(names)} |",
        "|---|" + "---:|" * len(names),
    ]
    for ladder, found in exponents(runs).items():
        cells = [f"{found[name]:.2f}" if name in found else "" for name in names]
        lines.append(f"| {ladder} | {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(file: Path, runs: list[Run]) -> None:
    """Seconds by stage above, memory below, a column per ladder; all logarithmic, linear growth dashed."""
    ladders = by_ladder(runs)
    figure, axes = pyplot.subplots(
        2, len(ladders), figsize=(13, 6.6), sharex="col", sharey="row", squeeze=False, height_ratios=(2.2, 1)
    )
    for (ladder, own), (above, below) in zip(ladders.items(), axes.T, strict=True):
        own = sorted(own, key=lambda run: run.shape.size)
        sizes = np.array([run.shape.size for run in own])
        for stage, colour in zip(stages(runs), COLOURS, strict=False):
            above.plot(
                sizes, [run.value(stage) or np.nan for run in own], "o-", ms=4, color=colour, label=stage
            )
        above.plot(sizes, [run.value(TOTAL) for run in own], "o-", ms=4, color="black", lw=2, label=TOTAL)
        below.plot(
            sizes, [run.peak_memory_bytes / 1e9 for run in own], "s-", ms=4, color="black", label=MEMORY
        )
        cache = [run.cache_file_bytes / 1e9 or np.nan for run in own]
        below.plot(sizes, cache, "s-", ms=4, color="#D55E00", label="ray cache on disk")
        guide(above, sizes, own[-1].value(TOTAL))
        guide(below, sizes, own[-1].peak_memory_bytes / 1e9)
        below.set_xlabel(ladder)
        for axis in (above, below):
            axis.set(xscale="log", yscale="log")
            axis.set_xticks(sizes, [f"{size:.3g}" if size < 1000 else f"{size:.0f}" for size in sizes])
            axis.xaxis.set_minor_locator(NullLocator())
            axis.yaxis.set_major_formatter("{x:g}")
            axis.yaxis.set_minor_formatter("")
            axis.grid(color="#DDDDDD", lw=0.6)
            axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set(ylabel="seconds", ylim=(0.05, 1.5 * max(run.value(TOTAL) for run in runs)))
    largest = max(max(run.peak_memory_bytes, run.cache_file_bytes) for run in runs) / 1e9
    axes[1, 0].set(ylabel="gigabytes", ylim=(0.1, 1.5 * largest))
    for row in axes:
        row[-1].legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
    figure.tight_layout()
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


def guide(axis: Axes, sizes: np.ndarray, last: float) -> None:
    """What linear growth looks like, up to the largest run's value."""
    axis.plot(sizes, last * sizes / sizes[-1], "--", color="#888888", lw=1, label="linear growth", zorder=0)


if __name__ == "__main__":
    main()
