"""Render a list of shots of one textured mesh with Cycles. Needs bpy; `real.py` writes the list.

    python benchmarks/cycles/shots.py LIST.json

LIST: mesh, width, height, focal (pixels), centre (pixels), pose (4 x 4 OpenGL camera-to-world), turn (4 x 4,
puts the mesh upright), samples, and
shots: file, texture, hdri (name of one that ships with Blender, or null: the albedo itself, unlit), rotation, gain.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np
from lights import Lighting, find_hdris
from mathutils import Matrix
from studio import (
    albedo_material,
    lit_material,
    load_mesh,
    open_studio,
    photograph,
    set_lighting,
    shipped_hdris,
    wear,
)


def main() -> None:
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    width, height = job["width"], job["height"]
    open_studio(width, 1.0, job["samples"], transparent=False)
    scene = bpy.context.scene
    scene.render.resolution_y = height
    lens = scene.camera.data
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens = 36.0 * job["focal"] / width
    lens.shift_x = (0.5 * width - job["centre"][0]) / width
    lens.shift_y = (job["centre"][1] - 0.5 * height) / width
    thing = load_mesh(Path(job["mesh"]))
    thing.matrix_world = Matrix(job["turn"])
    hdris = find_hdris(shipped_hdris())
    for shot in job["shots"]:
        image = bpy.data.images.load(shot["texture"], check_existing=True)
        image.colorspace_settings.name = "sRGB"
        lit = shot["hdri"] is not None
        wear(thing, lit_material(image) if lit else albedo_material(image))
        if lit:
            set_lighting(Lighting(shot["hdri"], shot["rotation"]), hdris)
        # the albedo itself is exact after a few samples, and needs no denoiser
        photograph(Path(shot["file"]), np.array(job["pose"]), shot["gain"], None if lit else 16)
        print(Path(shot["file"]).name, flush=True)


if __name__ == "__main__":
    main()
