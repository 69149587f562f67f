"""Albedo accuracy on GigaLit-style objects: `python3 dev.py bench gigalit DIR [--objects A B] [--json]`.

DIR holds scene folders as `render_scene.py` writes them. Each method makes a texture from the training
photos; the test cameras look at it, and the true albedo they saw is the measure. Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from measure.command import ROOT, dante_w
from measure.metrics import psnr, psnr_after_gain
from measure.pictures import read
from measure.views import linear_texture, viewer_of

#: A picture, the truth and a mask (H, W) to one number, for each column of the table.
METRICS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], float]] = {
    "PSNR": psnr,
    "PSNR after gain": psnr_after_gain,
}


@dataclass(frozen=True)
class Row:
    """One method on one object: each metric's mean over the test views, and the seconds it took."""

    object: str
    method: str
    scores: dict[str, float]
    seconds: float


def main() -> None:
    options = parse()
    methods: dict[str, list[str]] = {"photos averaged": ["average"]}
    for preset in options.preset:
        methods[f"ours, {preset}"] = ["recover", "--preset", preset]

    folders = sorted(file.parent for file in options.dir.glob("*/transforms_test.json"))
    if options.objects:
        folders = [folder for folder in folders if folder.name in options.objects]
    if not folders:
        sys.exit(f"{options.dir}: no such objects here; name a folder of scene folders.")
    rows = []
    for folder in folders:
        for method, arguments in methods.items():
            out = options.out / folder.name / method.replace(", ", "-").replace(" ", "-")
            _, seconds = dante_w([*arguments, str(folder), "--mesh", str(folder / "mesh.obj")], out)
            rows.append(Row(folder.name, method, score(out, folder), seconds))
            print(f"{folder.name}, {method}: {rows[-1].scores}, {seconds:.0f} s", file=sys.stderr, flush=True)
    rows += means(rows, list(methods))
    print(table(rows))
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows]}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("dir", type=Path, help="folder of scene folders")
    parser.add_argument("--objects", nargs="+", help="names; without it, all")
    parser.add_argument("--preset", nargs="+", default=["standard"])
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "gigalit", help="where the textures go")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def score(result: Path, scene: Path) -> dict[str, float]:
    """Every metric of a result's albedo, mean over the scene's test views."""
    viewer, texture = viewer_of(result, scene), linear_texture(result)
    values: dict[str, list[float]] = {name: [] for name in METRICS}
    for index, file in enumerate(viewer.truth):
        truth, alpha = read(file)
        picture, full = viewer.view(texture, index)
        mask = full & (alpha > 0.999)
        for name, metric in METRICS.items():
            values[name].append(metric(picture, truth, mask))
    return {name: float(np.mean(column)) for name, column in values.items()}


def means(rows: list[Row], methods: list[str]) -> list[Row]:
    """One more row per method: the mean over the objects."""
    result = []
    for method in methods:
        own = [row for row in rows if row.method == method]
        scores = {name: float(np.mean([row.scores[name] for row in own])) for name in METRICS}
        result.append(Row("mean", method, scores, float(np.mean([row.seconds for row in own]))))
    return result


def table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        f"| object | method | {' | '.join(METRICS)} | seconds |",
        f"|---|---|{'---:|' * len(METRICS)}---:|",
    ]
    for row in rows:
        scores = " | ".join(f"{row.scores[name]:.2f}" for name in METRICS)
        lines.append(f"| {row.object} | {row.method} | {scores} | {row.seconds:.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
