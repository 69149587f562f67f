"""Whether this checkout recovers the same bytes as another commit: `python3 dev.py bench same_bytes BEFORE [SCENE...]`.

For moves and renames that must change no result. Each scene is recovered with `draft` and `standard` by the sources of BEFORE, once,
and by those of this checkout; the SHA-256 of their albedo.png are compared. Left out, SCENE is the demo's own scene, rendered
when it is missing, and the apple, the bust and the fountain, where they are at hand. Exit code 1 if any byte differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from demo import SCENE as DEMO
from measure.command import ROOT, blender

PRESETS = ("draft", "standard")
KEPT = ROOT / "build" / "same_bytes"
SHARED = ROOT.parent / "shared"
SCENES = (
    SHARED / "gigalit/ph_food_apple_01",
    SHARED / "gigalit/statue_BustManWreath",
    SHARED / "scenes/fountain-P11",
)


def main() -> None:
    options = parse()
    before = _output(["git", "rev-parse", "--verify", f"{options.before}^{{commit}}"])
    differing = 0
    for scene in options.scenes or default_scenes():
        for preset in options.presets:
            wanted = known(before, scene, preset)
            start = time.monotonic()
            found = recovered(ROOT, scene, preset)
            same = found == wanted
            differing += not same
            verdict = "same bytes" if same else f"DIFFERENT: {found[:12]} for {wanted[:12]}"
            print(f"{scene.name:<28} {preset:<9} {verdict}  {time.monotonic() - start:.0f} s", flush=True)
    sys.exit(1 if differing else 0)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("before", metavar="BEFORE", help="commit whose bytes are to be met")
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE")
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    return parser.parse_args()


def default_scenes() -> list[Path]:
    """The demo's scene, and the shared ones that are there."""
    demo = ROOT / "build" / "demo" / "scene"
    if not (demo / "transforms_train.json").is_file():
        blender("render_scene.py", [str(demo), *DEMO])
    return [demo, *(scene for scene in SCENES if scene.is_dir())]


def known(before: str, scene: Path, preset: str) -> str:
    """The hash that commit `before` comes to; worked out once and kept."""
    file = KEPT / before / "hashes.json"
    hashes: dict[str, str] = json.loads(file.read_text()) if file.is_file() else {}
    name = f"{scene.name} {preset}"
    if name not in hashes:
        hashes[name] = recovered(_sources(before), scene, preset)
        file.write_text(json.dumps(hashes, indent=1))
    return hashes[name]


def _sources(commit: str) -> Path:
    """A folder with the sources of a commit."""
    folder = KEPT / commit / "sources"
    if not folder.is_dir():
        folder.mkdir(parents=True)
        archive = subprocess.run(
            ["git", "archive", commit, "backend"], cwd=ROOT, stdout=subprocess.PIPE, check=True
        )
        subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


def recovered(sources: Path, scene: Path, preset: str) -> str:
    """SHA-256 of the albedo.png that the sources of a checkout recover."""
    out = KEPT / "out" / f"{scene.name}-{preset}"
    command = [sys.executable, "-I", str(sources / "backend" / "launch.py"), "recover", str(scene)]
    if (scene / "mesh.obj").is_file():  # some folders do not name their mesh
        command += ["--mesh", str(scene / "mesh.obj")]
    command += ["--preset", preset, "--out", str(out), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, encoding="utf-8", env=_environment())
    if done.returncode:
        sys.exit(f"{scene.name} {preset}: {done.stdout.strip().splitlines()[-1:]}")
    return hashlib.sha256((out / "albedo.png").read_bytes()).hexdigest()


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _output(command: list[str]) -> str:
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, encoding="utf-8")
    if done.returncode:
        sys.exit(f"{command[-1]} names no commit of this repository.")
    return done.stdout.strip()


if __name__ == "__main__":
    main()
