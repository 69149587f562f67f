"""Accuracy against time: `python3 dev.py bench tradeoff DIR [--irradiance field] [--knobs steps batch] [--minutes 45] [--json]`.

Of traced light, or of the paper's model (`field`), which have knobs of their own. DIR holds scene folders as `gigalit` wants them. Every preset, and `standard` with one knob turned at a time, runs
on every object. Prints a Markdown table of the means and writes tradeoff-IRRADIANCE.json and a figure with the Pareto
front to --out. Finished runs are kept there and used again as long as code, settings, scene and machine are the same: when
--minutes are over, or after an interruption, the same command goes on. Times count only on an idle machine. Its speed changes
within the hour all the same, so `standard` runs again beside each knob's values, and seconds are by it (`paces`).
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
from dante_w.presets import PRESETS
from measure.command import ROOT
from measure.curves import draw
from measure.machine import provenance, sentence
from measure.pareto import PRESET, Row, pareto_front, table, within_chance
from measure.scenes import scenes_in
from measure.score import score
from methods.variant import altered

VARIANT = ROOT / "benchmarks" / "methods" / "variant.py"
BASE = "standard"
#: Its rows show how far chance alone moves a result; they are no choice, so never on the front.
SEED = "seed"
RAW, ACCURACY = "PSNR", "PSNR after gain"
#: What a run takes on two cores, for the time left: seconds, samples fitted per second, and seconds a direction of light.
FIXED_SECONDS, SAMPLES_PER_SECOND, DIRECTION_SECONDS = 10.0, 7e5, 0.1
#: Stages whose seconds are those of fitting: what is no reading, casting or writing.
FITTING = ("optimise", "final pass", "transfer", "plan", "lights", "albedo")
TRACED, FIELD = "traced", "field"

#: A label and what it changes in `BASE`: fields of `Preset`, or options of the command where they begin with --.
Value = tuple[str, dict[str, Any]]
_TEXTURES: list[Value] = [
    ("planned", {}),
    *((f"{n}", {"--texture-size": n}) for n in (512, 1024, 2048, 4096)),
]
_SEEDS: list[Value] = [("0", {}), ("1", {"--seed": 1}), ("2", {"--seed": 2})]
_FIELD_KNOBS: dict[str, list[Value]] = {
    "steps": [(f"{n}", {"field.schedule.steps": n}) for n in (60, 150, 500, 1000, 2000)],
    "batch": [(f"{n >> 10}k", {"field.schedule.batch": n}) for n in (1 << 13, 1 << 15, 1 << 17)],
    "albedo-finest": [
        (f"{n} (2^{table})", {"field.model.albedo.finest": n, "field.model.albedo.log2_table": table})
        for n, table in ((512, 15), (1024, 17), (2048, 19), (4096, 21))
    ],
    "albedo-table": [(f"2^{n}", {"field.model.albedo.log2_table": n}) for n in (17, 19, 21)],
    "albedo-levels": [(f"{n}", {"field.model.albedo.levels": n}) for n in (8, 12, 16)],
    "mlp-width": [(f"{n}", {"field.model.hidden": n}) for n in (16, 32, 64)],
    "irradiance-finest": [(f"{n}", {"field.model.irradiance.finest": n}) for n in (8, 16, 32)],
    "texture-size": _TEXTURES,
    SEED: _SEEDS,
}
_TRACED_KNOBS: dict[str, list[Value]] = {
    "directions": [(f"{n}", {"traced.directions": n}) for n in (16, 32, 64, 128, 256, 400)],
    "rays a direction": [(f"{n}", {"traced.transport.rays_per_direction": n}) for n in (1, 3, 9, 27)],
    "shading points": [(f"{n} x {n}", {"traced.shading.side": n}) for n in (64, 128, 256, 512)],
    "points a step": [(f"{n}", {"traced.solver.points_per_step": n}) for n in (600, 2500, 10000)],
    "last steps": [(f"{n}", {"traced.solver.fine_steps": n}) for n in (5, 7, 14)],
    "texture-size": _TEXTURES,
    SEED: _SEEDS,
}
KNOBS = {TRACED: _TRACED_KNOBS, FIELD: _FIELD_KNOBS}


@dataclasses.dataclass(frozen=True)
class Setting:
    """A preset and what is changed in it."""

    knob: str
    label: str
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    preset: str = BASE
    irradiance: str = TRACED

    @property
    def inside(self) -> dict[str, Any]:
        """What `methods/variant.py` is to change."""
        return {name: value for name, value in self.changes.items() if not name.startswith("--")}

    @property
    def options(self) -> list[str]:
        """What the command itself offers."""
        return [f"{name}={value}" for name, value in self.changes.items() if name.startswith("--")]

    def content(self) -> list[Any]:
        """What runs, however it is called: settings of equal content are one run."""
        preset = altered(PRESETS[self.preset], self.inside)
        model = preset.field if self.irradiance == FIELD else preset.traced
        assert model is not None
        return [preset.texture_size, dataclasses.asdict(model), self.options]

    def expected_seconds(self) -> float:
        """On two cores, roughly."""
        preset = altered(PRESETS[self.preset], self.inside)
        if self.irradiance == TRACED:
            return FIXED_SECONDS + DIRECTION_SECONDS * preset.traced_settings().directions
        samples = sum(part.steps * part.batch for part in (preset.field.schedule, preset.field.final_pass))
        return FIXED_SECONDS + samples / SAMPLES_PER_SECOND


class Job(NamedTuple):
    """A setting on an object, and the file that holds what came of it. A knob's runs are its own."""

    setting: Setting
    scene: Path
    file: Path


def main() -> None:
    options = parse()
    scenes = scenes_in(options.dir, options.objects)
    facts = provenance()
    wanted = settings(options.presets, options.knobs, options.irradiance)
    machine = [options.device, *(facts[name] for name in ("processor", "cores", "gpu", "versions"))]
    jobs = [Job(each, scene, note(options.out, each, scene, machine)) for each in wanted for scene in scenes]
    measure(jobs, options)
    runs = [(each, [read(job.file) for job in jobs if job.setting is each]) for each in wanted]
    pace = paces(runs)
    rows = [
        mean_row(each, found, pace[each.knob]) for each, found in runs if all(found) and each.knob in pace
    ]
    if (PRESET, BASE) not in [(row.knob, row.label) for row in rows]:
        sys.exit(f"`{BASE}` has not been run on all objects yet; give it more --minutes.")
    front, near, chance = on_front(rows)
    device = next(run["device"] for _, found in runs for run in found if run)
    names = ", ".join(scene.name for scene in scenes)
    ranged = [by * next(row.seconds for row in rows if row.label == BASE) for by in pace.values()]
    print(
        f"{table(rows, front, near, BASE)}\n\nMeans over {names}; on {device}. `{BASE}` took {min(ranged):.1f} to "
        f"{max(ranged):.1f} s beside the {len(pace)} knobs, and seconds are by it. "
        f"Means of seeds that were run lie {chance:.2f} dB apart. {sentence(facts)}"
    )
    if len(rows) < len(wanted):
        print(
            f"{len(wanted) - len(rows)} of {len(wanted)} settings still miss runs: run this again.",
            file=sys.stderr,
        )
    marked = [
        {**dataclasses.asdict(row), "on_front": bool(on), "but_for_chance": bool(almost)}
        for row, on, almost in zip(rows, front, near, strict=True)
    ]
    content = {
        "made_with": {**facts, "device": device, "objects": names},
        "rows": marked,
        "paces": pace,
        "chance": chance,
        "runs": [read(job.file) | {"knob": job.setting.knob} for job in jobs if job.file.is_file()],
    }
    (options.out / f"tradeoff-{options.irradiance}.json").write_text(
        json.dumps(content, indent=1), encoding="utf-8"
    )
    title = (
        f"{facts['processor']}, {facts['cores']} cores" if device == "cpu" else str(facts["gpu"] or device)
    )
    model = "traced light" if options.irradiance == TRACED else "the paper's model"
    draw(
        options.out / f"tradeoff-{options.irradiance}.png",
        rows,
        front,
        f"{model}: {len(scenes)} objects on {title}",
    )
    if options.json:
        print(json.dumps(content))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("dir", type=Path, help="folder of scene folders")
    add("--objects", nargs="+", help="names; without it, all")
    add("--presets", nargs="*", default=["draft", "standard", "high"], choices=list(PRESETS))
    add("--irradiance", default=TRACED, choices=list(KNOBS), help="whose knobs are turned")
    add("--knobs", nargs="*", metavar="KNOB", help="; ".join(f"{i}: {', '.join(KNOBS[i])}" for i in KNOBS))
    add("--minutes", type=float, default=45.0, help="begin no run that would end later")
    add("--device", default="auto", choices=("auto", "cpu", "cuda", "mps"))
    add("--out", type=Path, default=ROOT / "build" / "tradeoff", help="where everything goes")
    add("--json", action="store_true", help="the last line is one JSON object")
    options = parser.parse_args()
    known = KNOBS[options.irradiance]
    if options.knobs is None:
        options.knobs = list(known)
    for knob in options.knobs:
        if knob not in known:
            parser.error(f"--knobs {knob}: {options.irradiance} has {', '.join(known)}.")
    return options


def settings(presets: Sequence[str], knobs: Sequence[str], irradiance: str = TRACED) -> list[Setting]:
    """The presets, then each knob's values; `BASE` is always among them, to compare with."""
    names = [name for name in PRESETS if name in {BASE, *presets}]
    return [
        *(Setting(PRESET, name, preset=name, irradiance=irradiance) for name in names),
        *(
            Setting(knob, label, changes, irradiance=irradiance)
            for knob in knobs
            for label, changes in KNOBS[irradiance][knob]
        ),
    ]


# --- runs -------------------------------------------------------------------------------------------


def note(out: Path, setting: Setting, scene: Path, machine: Sequence[Any]) -> Path:
    """Where the facts of one run are kept: the name holds all that they hang on."""
    parts = json.dumps([setting.knob, setting.content(), scene_digest(scene), code_digest(), *machine])
    return out / "runs" / f"{scene.name}-{hashlib.sha256(parts.encode()).hexdigest()[:16]}.json"


def code_digest() -> str:
    """Changes with the backend's sources, the variants and the scores."""
    scores = [
        ROOT / "benchmarks/measure" / f"{name}.py" for name in ("score", "metrics", "views", "pictures")
    ]
    files = sorted((ROOT / "backend/dante_w").rglob("*.py"))
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in [*files, VARIANT, *scores])).hexdigest()


@lru_cache
def scene_digest(scene: Path) -> str:
    """Changes with a scene's cameras and mesh, and with the names and sizes of its pictures."""
    files = sorted(file for file in scene.rglob("*") if file.is_file())
    listing = [[file.relative_to(scene).as_posix(), file.stat().st_size] for file in files]
    digest = hashlib.sha256(json.dumps(listing).encode())
    for file in [*sorted(scene.glob("*.json")), scene / "mesh.obj"]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def measure(jobs: Sequence[Job], options: argparse.Namespace) -> None:
    """Make the runs that are missing: presets first, then knob by knob, so that those to be compared are soon after each other."""
    missing = [job for job in jobs if not job.file.is_file()]
    code = code_digest()
    start, expected, pace = time.monotonic(), 0.0, 1.0
    for done, job in enumerate(missing):
        words = f"{job.setting.knob} {job.setting.label}, {job.scene.name}"
        left = pace * sum(each.setting.expected_seconds() for each in missing[done:])
        if time.monotonic() - start + pace * job.setting.expected_seconds() > 60.0 * options.minutes:
            say(f"--minutes are over; {len(missing) - done} runs, about {left / 60:.0f} minutes, are left")
            return
        say(f"{done + 1}/{len(missing)} {words}; {left / 60:.0f} minutes left in all")
        if done == 0:  # compiled code is kept from run to run, and the first must not pay for all
            quick = {
                "field.schedule.steps": 60,
                "traced.directions": 16,
            }  # fewer would be refused as telling nothing
            warm_up = Setting("", "warm-up", quick, irradiance=job.setting.irradiance)
            run(warm_up, job.scene, options.device, options.out)
            start = time.monotonic()
        try:
            facts = run(job.setting, job.scene, options.device, options.out)
        except RuntimeError as error:
            say(f"{words} is left out: {error}")
            continue
        if code_digest() != code:
            sys.exit("The code was changed while this ran; start again.")
        job.file.parent.mkdir(parents=True, exist_ok=True)
        partial = job.file.with_suffix(".partial")
        partial.write_text(json.dumps(facts, indent=1), encoding="utf-8")
        partial.replace(job.file)
        expected += job.setting.expected_seconds()
        pace = (time.monotonic() - start) / expected


def run(setting: Setting, scene: Path, device: str, out: Path) -> dict[str, Any]:
    """Run one setting on one object; returns what is worth keeping, and removes the rest.

    Raises:
        RuntimeError: the command failed; what it said.
    """
    load = psutil.getloadavg()[0]
    result = out / "result"
    shutil.rmtree(result, ignore_errors=True)
    command = [
        sys.executable,
        str(VARIANT),
        json.dumps(setting.inside),
        "recover",
        str(scene),
        "--irradiance",
        setting.irradiance,
    ]
    command += ["--mesh", str(scene / "mesh.obj"), "--preset", setting.preset, "--device", device]
    start = time.monotonic()
    done = subprocess.run(
        [*command, *setting.options, "--out", str(result), "--json"], stdout=subprocess.PIPE, encoding="utf-8"
    )
    seconds = time.monotonic() - start
    if done.returncode:
        last = json.loads(done.stdout.splitlines()[-1]) if done.stdout else {}
        raise RuntimeError(last.get("message", f"ended with {done.returncode}"))
    report = json.loads((result / "report.json").read_text(encoding="utf-8"))
    scores = score(result, scene)
    shutil.rmtree(result)
    kept = ("texture_size", "samples", "held_out_psnr", "peak_memory_bytes")
    return {
        "object": scene.name,
        "changes": dict(setting.changes),
        "seconds": round(seconds, 2),
        "stages": report["seconds"],
        "scores": scores,
        "load_before": round(load, 2),
        "device": report.get("device", "cpu"),  # where light is traced
        **{name: report[name] for name in kept},
    }


def read(file: Path) -> dict[str, Any]:
    """The facts of a run, empty where it is still missing."""
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}


# --- results ----------------------------------------------------------------------------------------


def paces(runs: Iterable[tuple[Setting, Sequence[Mapping[str, Any]]]]) -> dict[str, float]:
    """By knob, how long `BASE` took beside its values, over the mean of all knobs; those alone that have it for all objects."""
    of_base = {
        setting.knob: sum(run["seconds"] for run in found)
        for setting, found in runs
        if all(found) and setting.content() == dataclasses.replace(setting, changes={}, preset=BASE).content()
    }
    mean = sum(of_base.values()) / max(len(of_base), 1)
    return {knob: seconds / mean for knob, seconds in of_base.items()}


def mean_row(setting: Setting, runs: Iterable[Mapping[str, Any]], pace: float) -> Row:
    """Means over objects; seconds are divided by the machine's `pace` at the time."""
    columns = [
        (
            run["seconds"] / pace,
            sum(run["stages"].get(stage, 0.0) for stage in FITTING) / pace,
            run["scores"][RAW],
            run["scores"][ACCURACY],
        )
        for run in runs
    ]
    return Row(setting.knob, setting.label, *np.mean(columns, axis=0).tolist())


def on_front(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray, float]:
    """(N,) bool: the rows on the Pareto front of seconds and PSNR after gain, and those that are on it but for chance; with chance
    in dB, how far seeds lie apart."""
    choices = np.array([row.knob != SEED for row in rows])
    front, near = np.zeros((2, len(rows)), bool)
    points = np.array([(row.seconds, row.psnr_after_gain) for row in rows])[choices]
    by_seed = [row.psnr_after_gain for row in rows if row.knob == SEED]
    chance = float(np.ptp(by_seed)) if by_seed else 0.0
    front[choices] = pareto_front(*points.T)
    near[choices] = within_chance(*points.T, chance)
    return front, near, chance


def say(text: str) -> None:
    print(f"== {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
