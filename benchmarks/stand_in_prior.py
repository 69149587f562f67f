"""How far the stand-in priors are from the truth: `python3 dev.py bench stand_in_prior DIR [--calibrate]`.

DIR holds scene folders as `render_scene.py` writes them. For each strength this makes the stand-in priors of
every object and measures albedo PSNR in the test views: of the raw prior, and of the texture that lifting alone
("w/o PR" in the paper) makes of the training views' priors. Prints a Markdown table with the paper's figures
beside them. With `--calibrate` it changes the factors of the strengths until both means meet the paper's, and
prints what to put into `methods/stand_in_prior.py`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from measure.command import ROOT, dante_w
from measure.scenes import scenes_in
from measure.score import compare, file_views, score
from measure.tables import PAPER
from methods.stand_in_prior import STRENGTHS, Strength, make_priors

NEAR_ENOUGH = 0.05  # dB between a mean and the paper's figure
ROUNDS = 8


class Figures(NamedTuple):
    """Albedo PSNR in dB of the raw prior and of what lifting alone makes of it."""

    raw: float
    lifted: float


def main() -> None:
    options = parse()
    scenes = scenes_in(options.dir)
    results = {}
    for name in options.strengths:
        strength = STRENGTHS[name]
        figures = measure(scenes, strength, options.out / name, options.preset)
        if options.calibrate:
            for _ in range(ROUNDS):
                if off(mean(figures), in_paper(name)) <= NEAR_ENOUGH:
                    break
                strength = nearer(strength, mean(figures), in_paper(name))
                figures = measure(scenes, strength, options.out / name, options.preset)
            else:
                sys.exit(
                    f"{name}: still {off(mean(figures), in_paper(name)):.2f} dB off after {ROUNDS} rounds."
                )
        results[name] = (strength, figures)
    print(table(results))
    for name, (strength, _) in results.items():
        print(f'    "{name}": Strength(shared={strength.shared:.4g}, own={strength.own:.4g}),')
    if options.json:
        print(json.dumps({name: content(*result) for name, result in results.items()}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("dir", type=Path, help="folder of scene folders")
    parser.add_argument(
        "--calibrate", action="store_true", help="find the factors that meet the paper's figures"
    )
    parser.add_argument("--strengths", nargs="+", default=list(STRENGTHS), choices=list(STRENGTHS))
    parser.add_argument("--preset", default="standard", help="of the lifting")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build" / "stand_in_prior", help="where it all goes"
    )
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def measure(scenes: Sequence[Path], strength: Strength, out: Path, preset: str) -> dict[str, Figures]:
    """Make and lift the priors of every scene; the figures by scene name."""
    figures = {}
    for scene in scenes:
        priors, lifted = out / scene.name / "priors", out / scene.name / "lifted"
        make_priors(scene, strength, priors)
        truths = sorted((scene / "test").glob("albedo_*.png"))
        raw = compare(file_views([priors / "test" / truth.name for truth in truths], truths))
        lift = ["--mesh", str(scene / "mesh.obj"), "--priors", str(priors / "train"), "--no-photometric"]
        dante_w(["recover", str(scene), *lift, "--preset", preset], lifted)
        figures[scene.name] = Figures(raw["PSNR"], score(lifted, scene)["PSNR"])
        print(f"{scene.name}, {strength}: {figures[scene.name]}", file=sys.stderr, flush=True)
    return figures


def mean(figures: dict[str, Figures]) -> Figures:
    return Figures(*(float(column) for column in np.mean(list(figures.values()), axis=0)))


def in_paper(name: str) -> Figures:
    return Figures(PAPER[name]["raw"], PAPER[name]["lifted"])


def off(figures: Figures, paper: Figures) -> float:
    """The larger of the two distances in dB."""
    return max(abs(ours - theirs) for ours, theirs in zip(figures, paper, strict=True))


def nearer(strength: Strength, figures: Figures, paper: Figures) -> Strength:
    """The strength that would meet the paper's figures if lifting left the shared error alone and removed the own
    error, and both grew as their factors. Neither is quite so, hence several rounds."""

    def squares(pair: Figures) -> tuple[float, float]:
        """Mean squared error of what lifting leaves and of what it removes."""
        left = 10.0 ** (-pair.lifted / 10.0)
        return left, max(10.0 ** (-pair.raw / 10.0) - left, 1e-9)

    (left, removed), (paper_left, paper_removed) = squares(figures), squares(paper)
    shared = strength.shared * math.sqrt(paper_left / left)
    return Strength(shared, strength.own * math.sqrt(paper_removed / removed))


def table(results: dict[str, tuple[Strength, dict[str, Figures]]]) -> str:
    """Markdown, a row per strength and object."""
    lines = ["| stand-in prior for | object | raw prior, dB | lifted alone, dB |", "|---|---|---:|---:|"]
    for name, (_, figures) in results.items():
        rows = {**figures, "mean": mean(figures), "the paper's": in_paper(name)}
        lines += [f"| {name} | {label} | {row.raw:.2f} | {row.lifted:.2f} |" for label, row in rows.items()]
    return "\n".join(lines)


def content(strength: Strength, figures: dict[str, Figures]) -> dict[str, object]:
    """One strength's part of the JSON object."""
    objects = {name: pair._asdict() for name, pair in figures.items()}
    return {**vars(strength), "objects": objects, "mean": mean(figures)._asdict()}


if __name__ == "__main__":
    main()
