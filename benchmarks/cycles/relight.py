"""Render a scene folder's test views relit, with albedo of your choice. Needs bpy.

    python benchmarks/cycles/relight.py SCENE --out DIR [--hdris H] [--views 0 3]
        [--texture NAME=albedo.png ...]     a texture on the mesh's UVs: sRGB, or EXR in linear Rec.709
        [--pictures NAME=FOLDER ...]        FOLDER/albedo_NNN.png: what test camera NNN sees, sRGB

DIR/NAME_HDRI_NNN.png can be held against test/relit_HDRI_NNN.png: views, lightings, exposures and gloss are
those of the scene's own test views and the same for every NAME, so that only the albedo differs. A diffuse
albedo says nothing of gloss; relit without any, saturated colours would come out wrong by far more than the
methods differ. The true texture's score is the most that any NAME can reach.

Pictures that an earlier run made from the same inputs are kept, others are rendered again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from lights import Gloss, find_hdris, hdris_named, relights_of
from projected import screen_image
from studio import lit_material, load_mesh, open_studio, photograph, set_lighting, shipped_hdris, wear


def main() -> None:
    options = parse()
    scene, out, named = options.scene, options.out, relights_of(options.scene)
    gloss = Gloss(
        named.gloss.roughness if options.roughness is None else options.roughness,
        named.gloss.specular if options.specular is None else options.specular,
    )
    test = json.loads((scene / "transforms_test.json").read_text(encoding="utf-8"))
    views = range(len(test["frames"])) if options.views is None else options.views
    hdris = hdris_named([light.hdri for light in named.lights], find_hdris(options.hdris or shipped_hdris()))
    textures, pictures = pairs(options.texture), pairs(options.pictures)
    check(textures, pictures, views)

    out.mkdir(parents=True, exist_ok=True)
    masks = [scene / frame["file_path"] for frame in test["frames"]]
    common = [scene / "mesh.obj", scene / "transforms_test.json", *hdris.values(), *masks]
    settings = f"{named} {gloss} {options.samples} {bpy.app.version_string}"
    for name, path in {**textures, **pictures}.items():
        inputs = [path] if name in textures else sorted(path.glob("albedo_*.png"))
        keep_only_from(digest(settings, common + inputs), out, name, hdris)

    open_studio(test["w"], test["camera_angle_x"], options.samples)
    # what the denoiser is told of albedo and normals is all but free of noise here, and cleaning it first blurs the
    # texture: 16 samples without that come nearer to the truth than 32 with it, in less time
    bpy.context.scene.cycles.denoising_prefilter = "NONE"
    thing = load_mesh(scene / "mesh.obj")
    jobs = [
        (light, name, index) for light in named.lights for name in {**textures, **pictures} for index in views
    ]
    materials: dict[Path, bpy.types.Material] = {}
    start, hung, worn = time.monotonic(), None, None
    for number, (light, name, index) in enumerate(jobs, 1):
        file = out / f"{name}_{light.hdri}_{index:03}.png"
        if file.exists():
            continue
        if light != hung:  # a second or so: Cycles looks where an HDRI is bright
            set_lighting(light, hdris)
            hung = light
        source = textures[name] if name in textures else pictures[name] / f"albedo_{index:03}.png"
        if source not in materials:
            if name in textures:
                image = uv_image(source)
            else:
                image = screen_image(source, masks[index])
            materials[source] = lit_material(image, gloss.roughness, gloss.specular, name in pictures)
        if source != worn:
            free_pixels()
            wear(thing, materials[source])
            worn = source
        photograph(file, np.array(test["frames"][index]["transform_matrix"]), named.gains[light.hdri])
        print(f"[{number}/{len(jobs)}] {file.name} {time.monotonic() - start:.1f} s", flush=True)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--texture", nargs="*", default=[], metavar="NAME=FILE")
    parser.add_argument("--pictures", nargs="*", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--views", type=int, nargs="*", help="test views; without it, all")
    parser.add_argument("--hdris", type=Path, help="folder of the HDRIs; without it, Blender's own")
    parser.add_argument("--samples", type=int, default=16, help="a pixel; denoised")
    parser.add_argument("--roughness", type=float, help="of the material; without it, the scene's own")
    parser.add_argument("--specular", type=float, help="likewise; 0 with roughness 1 is purely diffuse")
    return parser.parse_args()


def pairs(arguments: list[str]) -> dict[str, Path]:
    """`NAME=PATH` arguments by name."""
    split = [argument.partition("=") for argument in arguments]
    return {name: Path(path).resolve() for name, _, path in split}


def check(textures: dict[str, Path], pictures: dict[str, Path], views: range | list[int]) -> None:
    """End with a sentence if a name is used twice or a file is not there: before hours of rendering, not after."""
    twice = sorted(textures.keys() & pictures.keys())
    if twice:
        sys.exit(f"{', '.join(twice)}: names both a texture and pictures; give each a name of its own.")
    files = [*textures.values()]
    files += [folder / f"albedo_{index:03}.png" for folder in pictures.values() for index in views]
    missing = [str(file) for file in files if not file.is_file()]
    if missing:
        sys.exit(f"{missing[0]}: no such file (and {len(missing) - 1} more); every NAME needs its own.")


def digest(settings: str, files: list[Path]) -> str:
    """One line that changes when the settings or the content of a file does."""
    total = hashlib.sha256(settings.encode())
    for file in files:
        total.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()


def keep_only_from(inputs: str, out: Path, name: str, hdris: Iterable[str]) -> None:
    """Remove NAME's pictures unless they were rendered from `inputs`, a digest; what stays is not stale."""
    note = out / f"{name}.inputs"
    if note.is_file() and note.read_text() == inputs:
        return
    for hdri in hdris:
        for file in out.glob(f"{name}_{hdri}_*.png"):
            file.unlink()
    note.write_text(inputs)


def uv_image(file: Path) -> bpy.types.Image:
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Linear Rec.709" if file.suffix.lower() == ".exr" else "sRGB"
    return image


def free_pixels() -> None:
    """Let go of what was loaded from files, to be loaded again on demand: twenty large textures fill the memory.

    The images themselves stay: Cycles knows an image by its address, and would show the one that was there before.
    """
    for image in bpy.data.images:
        if image.source == "FILE":
            image.buffers_free()


if __name__ == "__main__":
    main()
