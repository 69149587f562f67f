"""A capture of real photos, before and after: `python3 dev.py bench real SCENE --out DIR`.

Recovers the albedo of a scene folder or COLMAP model, averages the photos beside it, relights both with Cycles
from the place of one photo, and writes one picture, DIR/real.png. Nothing is measured: there is no truth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from command import blender, dante_w
from dante_w.load import load_scene
from pictures import caption, grid, read, write

WIDTH = 560
LIGHTS = (("city", 1.0, 1.0), ("sunset", 2.6, 1.0), ("night", 0.6, 4.0))  # HDRI, rotation, gain


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
    photo = render(options, out)

    def shown(name: str) -> Path:
        return out / f"{name}.png"

    rows = [
        [
            (photo, "One of the photos"),
            (shown("averaged"), "Photos averaged"),
            (shown("recovered"), "Recovered albedo"),
        ],
        [(shown(f"recovered_{hdri}"), f"Recovered, relit: {hdri}") for hdri, *_ in LIGHTS],
    ]
    tiles = [[caption(read(file)[0], title) for file, title in row] for row in rows]
    write(out / "real.png", grid(tiles))
    print(f"held-out photos: {report['held_out_psnr']:.1f} dB, {report['seconds']}\n{out / 'real.png'}")


def render(options: argparse.Namespace, out: Path) -> Path:
    """Render every shot from the place of the chosen photo; returns that photo, made small."""
    scene, _ = load_scene(options.scene)
    frame = scene.frames[options.photo]
    camera = frame.camera
    scale = WIDTH / camera.width
    up = np.mean([each.camera_to_world[:3, 1] for each in scene.frames], axis=0)
    turn = upright(up)
    focal, centre = camera.params[0] * scale, [value * scale for value in camera.params[2:4]]
    shots = [
        {
            "file": out / f"{name}.png",
            "texture": out / name / "albedo.png",
            "hdri": None,
            "rotation": 0,
            "gain": 1,
        }
        for name in ("averaged", "recovered")
    ]
    for hdri, rotation, gain in LIGHTS:
        file, texture = out / f"recovered_{hdri}.png", out / "recovered" / "albedo.png"
        shots.append({"file": file, "texture": texture, "hdri": hdri, "rotation": rotation, "gain": gain})
    job = {
        "mesh": scene.mesh,
        "width": WIDTH,
        "height": round(camera.height * scale),
        "focal": focal,
        "centre": centre,
        "pose": (turn @ frame.camera_to_world).tolist(),
        "turn": turn.tolist(),
        "samples": 48,
        "shots": shots,
    }
    listing = out / "shots.json"
    listing.write_text(json.dumps(job, default=str), encoding="utf-8")
    blender("shots.py", [str(listing)])
    small = out / "photo.png"
    photo = oiio.ImageBuf(str(frame.image))
    resized = oiio.ImageBufAlgo.resize(photo, roi=oiio.ROI(0, WIDTH, 0, job["height"]))
    resized.write(str(small))
    return small


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
