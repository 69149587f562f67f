"""Render a scene folder's mesh with textures of your choice, under its held-out HDRIs. Needs bpy.

    python benchmarks/cycles/relight.py SCENE --texture NAME=albedo.png ... --out DIR [--views 0 3] [--hdris H ...]

Views, lightings and exposures are those of the scene's own test views, so that DIR/NAME_HDRI_NNN.png
can be held against test/relit_HDRI_NNN.png.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import bpy
import numpy as np
from studio import (
    Lighting,
    find_hdris,
    lit_material,
    load_mesh,
    open_studio,
    photograph,
    set_lighting,
    shipped_hdris,
    wear,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--texture", nargs="+", required=True, metavar="NAME=FILE")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--views", type=int, nargs="*", help="test views; without it, all")
    parser.add_argument("--hdris", type=Path, help="folder of the HDRIs; without it, Blender's own")
    parser.add_argument("--samples", type=int, default=64)
    options = parser.parse_args()

    test = json.loads((options.scene / "transforms_test.json").read_text(encoding="utf-8"))
    truth = json.loads((options.scene / "truth.json").read_text(encoding="utf-8"))
    open_studio(test["w"], test["camera_angle_x"], options.samples)
    thing = load_mesh(options.scene / "mesh.obj")
    hdris = find_hdris(options.hdris or shipped_hdris())
    options.out.mkdir(parents=True, exist_ok=True)
    materials = {}
    for name, _, file in (pair.partition("=") for pair in options.texture):
        image = bpy.data.images.load(str(Path(file).resolve()))
        image.colorspace_settings.name = "Linear Rec.709" if file.lower().endswith(".exr") else "sRGB"
        materials[name] = lit_material(image)
    for light in (Lighting(**entry) for entry in truth["relights"]):
        set_lighting(light, hdris)
        for name, material in materials.items():
            wear(thing, material)
            for index in options.views if options.views is not None else range(len(test["frames"])):
                pose = np.array(test["frames"][index]["transform_matrix"])
                file = options.out / f"{name}_{light.hdri}_{index:03}.png"
                photograph(file, pose, test["relit_gain"][light.hdri])
                print(file.name, flush=True)


if __name__ == "__main__":
    main()
