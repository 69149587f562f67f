"""What each weight of the traced method is worth on spoilt photos: `python3 dev.py bench robustness SCENE... [--json]`.

SCENE is a folder as `make_gigalit` writes it. It is spoilt in the ways that real photos are (`measure/spoils.py`), each
apart, by --seed. The product recovers each copy by traced light with all weights, with each one left out, and with none. Test cameras of the unspoilt scene look at the textures. Prints Markdown tables of albedo PSNR.
"""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from dante_w.commands import cli
from dante_w.core.color import srgb_from_linear_array
from dante_w.presets import PRESETS
from dante_w.scene.images import read_texture, write_png
from dante_w.traced.pixel_weights import USUAL, PixelWeightSettings
from measure.command import ROOT
from measure.machine import provenance, sentence
from measure.score import AFTER_GAIN, score
from measure.spoils import SPOILS, spoilt

#: What leaves each weight out.
LEFT_OUT: dict[str, Any] = {
    "clipped": {"clipped_from": float("inf")},
    "dark": {"noise": 0.0},
    "edge": {"near_edge": 0},
    "outlier": {"outlier": float("inf")},
}
VARIANTS = {
    "all weights": USUAL,
    **{f"without {name}": replace(USUAL, **changes) for name, changes in LEFT_OUT.items()},
    "none": replace(
        USUAL, **{name: value for changes in LEFT_OUT.values() for name, value in changes.items()}
    ),
}


@dataclass(frozen=True)
class Row:
    """Albedo PSNR of one texture in the test views, in dB, as it is and after one gain per channel."""

    scene: str
    spoil: str
    variant: str
    psnr: float
    after_gain: float


def main() -> None:
    options = parse()
    rows = [
        row for scene in options.scenes for spoil in options.spoils for row in measured(scene, spoil, options)
    ]
    facts = provenance()
    for name in dict.fromkeys(row.scene for row in rows):
        print(f"{table([row for row in rows if row.scene == name], name)}\n")
    print(f"Preset {options.preset}, texture {options.texture_size}, seed {options.seed}. {sentence(facts)}")
    if options.json:
        print(json.dumps({"measured": facts, "rows": [asdict(row) for row in rows]}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("scenes", type=Path, nargs="+", metavar="SCENE")
    add("--spoils", nargs="+", default=list(SPOILS), choices=SPOILS)
    add("--preset", default="draft", help="of the traced method; the others take minutes more for each spoil")
    add("--texture-size", type=int, default=1024)
    add("--seed", type=int, default=0)
    add("--out", type=Path, default=ROOT / "build" / "robustness", help="for spoilt scenes and textures")
    add("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def measured(scene: Path, spoil: str, options: argparse.Namespace) -> list[Row]:
    """A row for each of `VARIANTS` on one spoilt copy of a scene."""
    print(f"== {scene.name}, {spoil}", file=sys.stderr, flush=True)
    folder = options.out / scene.name / spoil
    copy = spoilt(scene, spoil, folder / "scene", options.seed)
    rows = []
    for variant, texture in textures(copy, folder / "recovered", options).items():
        file = folder / f"{variant}.png"
        write_png(file, np.rint(255.0 * srgb_from_linear_array(texture).clip(0.0, 1.0)).astype(np.uint8))
        scores = score(file, scene)
        rows.append(Row(scene.name, spoil, variant, scores["PSNR"], scores["PSNR" + AFTER_GAIN]))
        print(f"   {variant}: {rows[-1].after_gain:.2f} dB after gain", file=sys.stderr, flush=True)
    return rows


def textures(scene: Path, out: Path, options: argparse.Namespace) -> dict[str, np.ndarray]:
    """The product's linear texture (S, S, 3) for each of `VARIANTS`."""
    return {
        variant: recovered(scene, out / variant, weights, options) for variant, weights in VARIANTS.items()
    }


def recovered(
    scene: Path, out: Path, weights: PixelWeightSettings, options: argparse.Namespace
) -> np.ndarray:
    """The linear texture (S, S, 3) that the product recovers with these weights."""
    preset = PRESETS[options.preset]
    traced = preset.traced_settings()
    shading, albedo = replace(traced.shading, weights=weights), replace(traced.albedo, weights=weights)
    settings = replace(preset, traced=replace(traced, shading=shading, albedo=albedo))
    command = ["recover", str(scene), "--irradiance", "traced", "--preset", options.preset, "--format", "exr"]
    command += ["--texture-size", str(options.texture_size), "--out", str(out)]
    with redirect_stdout(sys.stderr):
        if cli.main(command, settings=settings):
            sys.exit(f"{scene}: the traced method failed; see above.")
    return read_texture(out / "albedo.exr")


def table(rows: list[Row], scene: str) -> str:
    """One scene as a Markdown table: a line for each spoil, a column for each variant."""
    variants = list(dict.fromkeys(row.variant for row in rows))
    lines = [f"| {scene} | {' | '.join(variants)} |", f"|---|{'---:|' * len(variants)}"]
    for spoil in dict.fromkeys(row.spoil for row in rows):
        cells = {row.variant: f"{row.psnr:.2f} / {row.after_gain:.2f}" for row in rows if row.spoil == spoil}
        lines.append(f"| {spoil} | {' | '.join(cells.get(variant, '') for variant in variants)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
