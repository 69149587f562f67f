"""The whole job on a small scene of its own: `python3 dev.py demo [--out DIR] [--preset P]`.

Renders photos of a painted object under changing light with Cycles, recovers its albedo texture, compares
it with the truth beside "photos averaged on the texture", relights it, and puts it all into one picture.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path

import numpy as np
from measure.command import ROOT, blender, dante_w
from measure.metrics import psnr
from measure.pictures import PAPER, caption, grid, read, read_on_paper, trim, write
from measure.score import score
from measure.views import linear_texture, viewer_of

HELD_OUT = "sunset"
SCENE = [
    *("--photos", "24", "--test", "6", "--relit-views", "0", "--size", "384", "--samples", "16"),
    *("--lightings", "4", "--suns", "1", "--train-hdris", "city", "courtyard", "forest", "sunrise"),
    *("--held-out", HELD_OUT),
]
VIEW = 0  # the test view shown
PHOTO = 3  # the photo shown


def main() -> None:
    options = parse()
    out, start = options.out.resolve(), time.monotonic()
    scene, averaged, recovered = out / "scene", out / "averaged", out / "recovered"
    if options.fresh:
        shutil.rmtree(out, ignore_errors=True)

    say("rendering 24 photos of a painted object with Cycles")
    blender("render_scene.py", [str(scene), *SCENE])
    say("averaging the photos on the texture")
    dante_w(["average", str(scene), "--texture-size", "1024"], averaged)
    say(f"recovering the albedo, preset {options.preset}")
    recover = ["recover", str(scene), "--texture-size", "1024", "--preset", options.preset]
    _, seconds = dante_w(recover, recovered)
    say(f"relighting under {HELD_OUT}, which no photo was taken in")
    textures = {"truth": scene / "albedo_gt.png", "result": recovered / "albedo.png"}
    pairs = [f"{name}={file}" for name, file in textures.items()]
    relights = ["--texture", *pairs, "--out", str(out / "relit"), "--views", str(VIEW), "--samples", "48"]
    blender("relight.py", [str(scene), *relights])

    scores = {"photos averaged": score(averaged, scene), "DANTE-W": score(recovered, scene)}
    print(f"\n{'albedo in 6 test views':<24} {'PSNR':>8} {'after one gain per channel':>28}")
    for name, values in scores.items():
        print(f"{name:<24} {values['PSNR']:>5.1f} dB {values['PSNR after gain']:>25.1f} dB")
    write(out / "demo.png", picture(out, scores))
    print(f"\n{out / 'demo.png'}\nrecovered in {seconds:.0f} s, all in {time.monotonic() - start:.0f} s")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "demo")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--fresh", action="store_true", help="render the photos again too")
    return parser.parse_args()


def say(text: str) -> None:
    print(f"== {text}", flush=True)


def picture(out: Path, scores: dict[str, dict[str, float]]) -> np.ndarray:
    """Photo, averaged texture, recovered albedo; truth, relit truth, relit result."""
    scene = out / "scene"
    true_albedo = scene / f"test/albedo_{VIEW:03}.png"

    def decibels(name: str) -> str:
        values = scores[name]
        return f"{values['PSNR']:.1f} dB, {values['PSNR after gain']:.1f} dB after one gain per channel"

    def seen(result: Path) -> np.ndarray:
        view, _ = viewer_of(result, scene).view(linear_texture(result), VIEW)
        _, alpha = read(true_albedo)
        return view * alpha[..., None] + PAPER * (1.0 - alpha[..., None])

    relit = {name: out / "relit" / f"{name}_{HELD_OUT}_{VIEW:03}.png" for name in ("truth", "result")}
    (true_light, alpha), (our_light, _) = read(relit["truth"]), read(relit["result"])
    relit_psnr = psnr(our_light, true_light, alpha > 0.999)

    tiles = [
        (
            read_on_paper(scene / f"train/{PHOTO:03}.png"),
            "One of 24 photos",
            "each with its own light and exposure",
        ),
        (seen(out / "averaged"), "Photos averaged on the texture", decibels("photos averaged")),
        (seen(out / "recovered"), "Albedo recovered by DANTE-W", decibels("DANTE-W")),
        (read_on_paper(true_albedo), "True albedo", "painted, known only to the renderer"),
        (read_on_paper(relit["truth"]), "True albedo, relit", "Cycles, an HDRI and a sun no photo saw"),
        (read_on_paper(relit["result"]), "Recovered albedo, relit", f"{relit_psnr:.1f} dB"),
    ]
    trimmed = trim([tile for tile, _, _ in tiles])
    captioned = [caption(tile, *words) for tile, (_, *words) in zip(trimmed, tiles, strict=True)]
    return grid([captioned[:3], captioned[3:]])


if __name__ == "__main__":
    main()
