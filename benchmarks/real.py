"""A capture of real photos, before and after: `python3 dev.py bench real SCENE --out DIR`.

Recovers the albedo of a scene folder or COLMAP model, averages the photos on the texture beside it, relights
both with Cycles from the place of one photo, and writes one picture, DIR/real.png. There is no truth to measure by.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from dante_w.scene.load import load_scene
from measure.command import blender, dante_w
from measure.pictures import caption, grid, read, write

WIDTH = 560
TEXTURES = {"averaged": "Photos averaged", "recovered": "Recovered albedo"}
LIGHTS = (("city", 1.0, 1.5), ("night", 0.6, 4.0))  # HDRI, rotation, gain


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--photo", type=int, default=0, help="index of the photo whose view is shown")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--texture-size", default="4096")
    options = parser.parse_args()
    out = options.out.resolve()
    size = ["--texture-size", options.texture_size]
    dante_w(["average", str(options.scene), *size], out / "averaged")
    report, _ = dante_w(["recover", str(options.scene), "--preset", options.preset, *size], out / "recovered")
    render(options, out)
    tiles = []
    for name, title in TEXTURES.items():
        lit = [(f"{name}_{hdri}", f"{title}, relit: {hdri}") for hdri, *_ in LIGHTS]
        row = [(name, f"{title}, unlit"), *lit]
        tiles.append([caption(read(out / f"{file}.png")[0], words) for file, words in row])
    write(out / "real.png", grid(tiles))
    for line in report["plan"]:
        print(f"{line['what']}: {line['choice']} ({line['reason']})")
    print(f"held-out photos: {report['held_out_psnr']} dB, {report['seconds']}\n{out / 'real.png'}")


def render(options: argparse.Namespace, out: Path) -> None:
    """Render every shot from the place of the chosen photo."""
    scene, _ = load_scene(options.scene)
    frame = scene.frames[options.photo]
    camera = frame.camera
    scale = WIDTH / camera.width
    up = np.mean([each.camera_to_world[:3, 1] for each in scene.frames], axis=0)
    turn = upright(up)
    focal, centre = camera.params[0] * scale, [value * scale for value in camera.params[2:4]]
    shots = []
    for name in TEXTURES:
        shot = {"texture": out / name / "albedo.png", "hdri": None, "rotation": 0.0, "gain": 1.0}
        shots.append({**shot, "file": out / f"{name}.png"})
        for hdri, rotation, gain in LIGHTS:
            light = {"hdri": hdri, "rotation": rotation, "gain": gain}
            shots.append({**shot, **light, "file": out / f"{name}_{hdri}.png"})
    job = {
        "mesh": scene.mesh,
        "width": WIDTH,
        "height": round(camera.height * scale),
        "focal": focal,
        "centre": centre,
        "pose": (turn @ frame.camera_to_world).tolist(),
        "turn": turn.tolist(),
        "samples": 48,
        "shots": sorted(shots, key=lambda shot: shot["hdri"] is not None),  # unlit first: no world yet
    }
    listing = out / "shots.json"
    listing.write_text(json.dumps(job, default=str), encoding="utf-8")
    blender("shots.py", [str(listing)])


def upright(up: np.ndarray) -> np.ndarray:
    """The 4 x 4 rotation that takes direction `up` to +Z: reconstructions stand any way round, HDRIs do not."""
    z = up / np.linalg.norm(up)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    turn = np.eye(4)
    turn[:3, :3] = x, np.cross(z, x), z
    return turn


if __name__ == "__main__":
    main()
