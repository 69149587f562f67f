"""The GigaLit-style benchmark: `python3 dev.py bench gigalit DIR [--presets ...] [--priors ...] [--json]`.

DIR holds scene folders as `make_gigalit` writes them. Every method makes a texture from the training photos;
the test cameras look at it, Cycles relights it under HDRIs no photo saw, and the truth is the measure.
Prints Markdown tables (mean and per object); finished work is kept in --out, and used again as long as
neither the scene nor the code behind it has changed. Priors are stand-ins made from the true albedo.

quality.json in --out is what a run says of its presets beforehand: backend/dante_w/estimate/quality.json, when gigalit.json
goes to docs/gigalit.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dante_w.presets import PRESETS
from measure.command import ROOT, blender
from measure.machine import provenance
from measure.metrics import psnr
from measure.perceptual import flip, lpips, ssim
from measure.scenes import scenes_in
from measure.score import View, albedo_views, compare, file_views
from measure.sheet import Column, write_sheet
from measure.tables import Row, markdown
from methods.rows import FULL, NO_PRIOR, Method, make, methods, priors_of, texture_of
from methods.stand_in_prior import STRENGTHS

METRICS = {"PSNR": psnr, "SSIM": ssim, "LPIPS": lpips, "FLIP": flip}
#: The rows that are drawn for each object, and what stands below them.
SHOWN = {
    "photos averaged": "photos averaged",
    "gradient-domain texturing": "gradient domain",
    "ours, traced light": "traced light",
    "raw prior": "raw prior",
    f"ours full (paper), {FULL}": "paper's model",
}


class Made(NamedTuple):
    """A row's method, the folder of its result, and the seconds that it took."""

    method: Method
    out: Path
    seconds: float


def main() -> None:
    options = parse()
    scenes = scenes_in(options.dir, options.objects)
    every = list(methods(options.presets, options.priors))
    rows, drawn = [row for row in every if options.rows.search(describe(row))], shown(every)
    facts = provenance()
    results = []
    for number, scene in enumerate(scenes, 1):
        folder = options.out / scene.name
        made: list[Made] = []
        for count, method in enumerate(rows, 1):
            out = folder / method.key(scene)
            say(f"object {number}/{len(scenes)} {scene.name}, row {count}/{len(rows)}: {describe(method)}")
            made.append(Made(method, out, make(method, scene, out)))
        views = relit_views(scene, options.relit_views)
        relit = relight(scene, made, views, options.hdris or beside(options.dir))
        for row in made:
            results.append(rated(row, scene, relit, views, str(facts["commit"])))
            say(f"{scene.name}, {describe(row.method)}: {results[-1].albedo['PSNR']:.2f} dB")
        if set(drawn) <= set(rows):
            sheet(
                options.out / f"{scene.name}.png", scene, [row for row in made if row.method in drawn], relit
            )
    results = among(results, options.out / "gigalit.json")
    text = markdown(results, facts)
    print(text)
    (options.out / "gigalit.md").write_text(text + "\n", encoding="utf-8")
    content = {"made_with": facts, "rows": [asdict(row) for row in results]}
    (options.out / "gigalit.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    (options.out / "quality.json").write_text(json.dumps(quality(results), indent=1) + "\n", encoding="utf-8")
    if options.json:
        print(json.dumps(content))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("dir", type=Path, help="folder of scene folders")
    add("--objects", nargs="+", help="names; without it, all")
    add(
        "--presets",
        nargs="+",
        default=["draft", "standard", "high"],
        help="`paper` takes hours without a GPU",
    )
    add("--priors", nargs="+", default=[NO_PRIOR, *STRENGTHS], choices=[NO_PRIOR, *STRENGTHS])
    add(
        "--rows",
        type=re.compile,
        default=re.compile(""),
        help="a pattern of those to make; others stay as --out has them, and pictures if it leaves out one of theirs",
    )
    add("--hdris", type=Path, help="folder of the HDRIs; without it, DIR/../hdri or Blender's own")
    add("--relit-views", type=int, default=4, help="how many test views are relit, under each HDRI")
    add("--out", type=Path, default=ROOT / "build" / "gigalit", help="where everything goes")
    add("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def among(results: list[Row], file: Path) -> list[Row]:
    """These rows in the place of those of the same name that `file` has, and its others, in the table's order."""
    kept = json.loads(file.read_text(encoding="utf-8"))["rows"] if file.is_file() else []
    rows = {(row.object, row.prior, row.method): row for row in (*(Row(**each) for each in kept), *results)}
    order = [(row.prior, row.name) for row in methods(tuple(PRESETS), (NO_PRIOR, *STRENGTHS))]
    return sorted(rows.values(), key=lambda row: (order.index((row.prior, row.method)), row.object))


def quality(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, float]]]:
    """What presets reach without priors, by model and preset: mean, lowest and highest albedo PSNR over objects, after one gain per
    channel. See `dante_w.estimate.expectation`."""
    figures: dict[str, dict[str, dict[str, float]]] = {"traced": {}, "field": {}}
    for method in methods(tuple(PRESETS), (NO_PRIOR,)):
        found = [
            row.albedo["PSNR after gain"]
            for row in rows
            if (row.method, row.prior) == (method.name, NO_PRIOR)
        ]
        if not found or method.arguments[:1] != ("recover",) or "--equal-bands" in method.arguments:
            continue
        words = dict(zip(method.arguments[1::2], method.arguments[2::2], strict=True))
        reached = {"mean": np.mean(found), "lowest": min(found), "highest": max(found)}
        model, preset = words.get("--irradiance", "traced"), words.get("--preset", "standard")
        figures[model][preset] = {name: round(float(value), 1) for name, value in reached.items()}
    return figures


def relight(scene: Path, made: list[Made], views: Sequence[int], hdris: Path | None) -> Path:
    """Render what is missing of every row under the scene's held-out HDRIs; returns the pictures' folder."""
    out = made[0].out.parent / "relit"
    textures, pictures = [], []
    for method, result, _ in made:
        if method.tool == "raw prior":
            pictures.append(f"{method.slug}={priors_of(method, scene, result) / 'test'}")
        else:
            textures.append(f"{method.slug}={texture_of(method, scene, result)}")
    arguments = [str(scene), "--out", str(out), "--views", *map(str, views)]
    arguments += ["--texture", *textures, "--pictures", *pictures]
    if hdris is not None:
        arguments += ["--hdris", str(hdris)]
    blender("relight.py", arguments)
    return out


def rated(row: Made, scene: Path, relit: Path, views: Sequence[int], commit: str) -> Row:
    """The scores of one finished row."""
    method, out, seconds = row
    seen = (relit / f"{method.slug}.inputs").read_bytes() + bytes(views) + code_of_scores()
    note = out / f"scores-{hashlib.sha256(seen).hexdigest()[:10]}.json"
    if not note.is_file():
        scores = {
            "albedo": compare(_albedo(method, scene, out), METRICS),
            "relit": compare(_relit(method, scene, relit, views), METRICS),
        }
        note.write_text(json.dumps(scores), encoding="utf-8")
    scores = json.loads(note.read_text(encoding="utf-8"))
    return Row(scene.name, method.name, method.prior, seconds, scores["albedo"], scores["relit"], commit)


def shown(rows: Sequence[Method]) -> list[Method]:
    """Those worth looking at, without a prior and with the first one."""
    first = next((row.prior for row in rows if row.prior != NO_PRIOR), NO_PRIOR)
    return [row for row in rows if row.name in SHOWN and row.prior in (NO_PRIOR, first)]


def sheet(file: Path, scene: Path, made: list[Made], relit: Path) -> None:
    """Draw the first test view of the rows."""
    columns, truth, relit_truth = [], None, None
    for method, out, _ in made:
        truth, lit = _albedo(method, scene, out)[0], _relit(method, scene, relit, [0])[0]
        relit_truth = lit.truth
        note = "no prior" if method.prior == NO_PRIOR else "stand-in prior"
        columns.append(Column(SHOWN[method.name], note, truth.picture, lit.picture))
    if truth is not None and relit_truth is not None:
        write_sheet(file, truth, relit_truth, columns)


def _albedo(method: Method, scene: Path, out: Path) -> list[View]:
    if method.tool == "raw prior":
        truths = sorted((scene / "test").glob("albedo_*.png"))
        return file_views([priors_of(method, scene, out) / "test" / file.name for file in truths], truths)
    return albedo_views(texture_of(method, scene, out) if method.tool == "truth" else out, scene)


def _relit(method: Method, scene: Path, relit: Path, views: Sequence[int]) -> list[View]:
    frames = test_frames(scene)
    pairs = [
        (relit / f"{method.slug}_{hdri}_{index:03}.png", scene / file)
        for index in views
        for hdri, file in frames[index]["relit"].items()
    ]
    return file_views([ours for ours, _ in pairs], [truth for _, truth in pairs])


def relit_views(scene: Path, count: int) -> list[int]:
    """Up to `count` test views that have relit pictures, evenly spread."""
    lit = [index for index, frame in enumerate(test_frames(scene)) if frame.get("relit")]
    return [lit[i] for i in sorted({round(i) for i in np.linspace(0, len(lit) - 1, min(count, len(lit)))})]


def test_frames(scene: Path) -> list[dict[str, Any]]:
    return list(json.loads((scene / "transforms_test.json").read_text(encoding="utf-8"))["frames"])


def beside(folder: Path) -> Path | None:
    """The folder of HDRIs beside a folder of scenes, if there is one."""
    hdris = folder.resolve().parent / "hdri"
    return hdris if hdris.is_dir() else None


def code_of_scores() -> bytes:
    names = ("score", "metrics", "perceptual", "views")
    return b"".join((ROOT / "benchmarks/measure" / f"{name}.py").read_bytes() for name in names)


def describe(method: Method) -> str:
    return method.name if method.prior == NO_PRIOR else f"{method.name} [{method.prior} stand-in]"


def say(text: str) -> None:
    print(f"== {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
