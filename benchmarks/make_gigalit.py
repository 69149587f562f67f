"""Scenes from any textured meshes and HDRIs: `python3 dev.py bench make_gigalit OBJECTS HDRIS --out DIR [--preset P]`.

OBJECTS: a folder. A subfolder with one mesh (OBJ, PLY, GLB; with UVs) and its albedo image is an object of the
subfolder's name; so is a mesh file with an image of the same name beside it. A GLB may carry its image itself.
HDRIS: a folder of .exr and .hdr files; some light the photos, others, held out, only the relit test views.

DIR/NAME becomes a scene folder as cycles/render_scene.py writes it: photos of the upper hemisphere, each under one of
a few lightings and with its own exposure; test views with true albedo, and relit. An interrupted run goes on where it
stopped, and ends with the same bytes; same seed, same scenes, whatever else lies in OBJECTS.

Preset `paper` has the counts of the DANTE-W paper's own GigaLit: 10 objects, 4096 x 4096 textures, 250 test views, 5
lightings with directional lamps for the photos and 5 held out. Photos, pixels, samples and that every test view is
relit are our choice. Preset `small` is ours, for a machine without a GPU.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from cycles.lights import find_hdris, hdris_named
from measure.command import ScriptFailed, blender_lines

MESHES = (".obj", ".ply", ".glb")
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
ALBEDO_WORDS = (
    "albedo",
    "basecolor",
    "base_color",
    "diffuse",
    "diff",
    "color",
)  # the first that fits decides


@dataclass(frozen=True)
class Preset:
    """How much is rendered. Per object, but for `objects`, the most that are taken (0: all)."""

    objects: int
    photos: int
    test: int
    relit_views: int
    size: int  # pixels on a side of every picture
    samples: int  # a pixel
    lightings: int
    held_out_count: int
    suns: float  # share of the lightings that have a directional lamp
    texture_size: int  # texels on the longer side; a larger true texture is resampled


PRESETS = {
    "small": Preset(0, 40, 8, 8, 512, 64, 5, 2, 0.4, 2048),
    "paper": Preset(10, 200, 250, 250, 1024, 256, 5, 5, 1.0, 4096),
}


#: What of a preset `render_scene.py` has an option of the same name for.
PASSED_ON = ("photos", "test", "relit_views", "size", "samples", "lightings", "suns", "texture_size")


@dataclass(frozen=True)
class Thing:
    """An object to render: `texture` is None where the mesh file carries it."""

    name: str
    mesh: Path
    texture: Path | None


def main() -> int:
    options = parse()
    wanted = preset_of(options)
    things, faults = find_things(options.objects)
    if wanted.objects:
        things = things[: wanted.objects]
        if len(things) < wanted.objects:
            say(f"{options.objects}: {wanted.objects} objects are asked for, {len(things)} can be used")
    training, held_out = choose_hdris(options, wanted)
    say(f"photos under {', '.join(training)}; held out: {', '.join(held_out)}")

    progress = Progress({thing.name: options.out / thing.name for thing in things}, wanted, len(held_out))
    made = 0
    for thing in things:
        command = arguments(thing, options, wanted, training, held_out)
        try:
            for line in blender_lines("render_scene.py", command):
                if line.startswith("["):
                    say(progress.line(thing.name, line.partition("] ")[2]))
                elif line.startswith("true texture"):
                    say(f"{thing.name}: {line}")
            made += 1
        except ScriptFailed as failed:
            faults.append(f"{thing.name}: {failed}")
        progress.finish(thing.name)
    say(f"{options.out}: {made} scenes")
    for fault in faults:
        print(f"left out: {fault}", file=sys.stderr, flush=True)
    return 1 if faults or not made else 0


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("objects", type=Path, help="folder of textured meshes")
    add("hdris", type=Path, help="folder of .exr and .hdr files")
    add("--out", type=Path, required=True)
    add("--preset", choices=PRESETS, default="small", help="what the options below are where not given")
    add("--max-objects", metavar="N", type=int, help="the first so many by name; 0: all")
    add("--photos", metavar="N", type=int)
    add("--test", metavar="N", type=int, help="test views")
    add("--relit-views", metavar="N", type=int, help="test views also rendered under the held-out HDRIs")
    add("--size", metavar="N", type=int, help="pixels on a side")
    add("--samples", metavar="N", type=int, help="a pixel; denoised")
    add("--lightings", metavar="N", type=int, help="for the photos")
    add("--held-out-count", metavar="N", type=int, help="HDRIs to relight under, 2 at least")
    add("--suns", type=float, help="share of the photos' lightings that have a directional lamp")
    add(
        "--texture-size",
        metavar="N",
        type=int,
        help="longer side of the true texture; a larger one is resampled",
    )
    add(
        "--train-hdris",
        nargs="+",
        metavar="H",
        help="names (or how they begin); without them, drawn by the seed",
    )
    add("--held-out", nargs="+", metavar="H", help="likewise, of the HDRIs held out")
    add("--up", choices=("Y", "Z"), default="Y", help="the mesh files' up axis (OBJ and PLY)")
    add("--roughness", type=float, default=1.0, help="of every object; 1 with specular 0 is purely diffuse")
    add("--specular", type=float, default=0.0)
    add("--seed", type=int, default=0)
    options = parser.parse_args()
    for folder in (options.objects, options.hdris):
        if not folder.is_dir():
            parser.error(f"{folder} is no folder")
    options.out = options.out.resolve()
    return options


def preset_of(options: argparse.Namespace) -> Preset:
    """The preset, with what the command line says instead."""
    given = {**vars(options), "objects": options.max_objects}
    known = [field.name for field in fields(Preset)]
    wanted = replace(PRESETS[options.preset], **{key: given[key] for key in known if given[key] is not None})
    if wanted.held_out_count < 2 or min(wanted.photos, wanted.test, wanted.relit_views, wanted.lightings) < 1:
        sys.exit("a scene needs a photo, a lighting, a relit test view and two held-out HDRIs; ask for more.")
    return replace(wanted, relit_views=min(wanted.relit_views, wanted.test))


def find_things(folder: Path) -> tuple[list[Thing], list[str]]:
    """What can be rendered in `folder`, by name, and a sentence for each mesh or subfolder that cannot."""
    things, faults = [], []
    for path in sorted(folder.iterdir()):
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        meshes = [file for file in inside if file.suffix.lower() in MESHES]
        if (path.is_file() and not meshes) or path.name.startswith("."):
            continue
        if len(meshes) != 1:
            faults.append(f"{path.name}: holds {len(meshes)} meshes ({', '.join(MESHES)}); leave one in it.")
            continue
        (mesh,) = meshes
        if path.is_file():
            inside = [file for file in sorted(folder.iterdir()) if file.stem == mesh.stem]
        name = path.stem if path.is_file() else path.name
        images = albedo_images(inside)
        if len(images) == 1 or (not images and mesh.suffix.lower() == ".glb"):
            things.append(Thing(name, mesh.resolve(), images[0].resolve() if images else None))
        else:
            listed = ", ".join(image.name for image in images) or "none"
            faults.append(f"{name}: needs one albedo image, has {listed}; name it albedo.png.")
    twice = {thing.name for thing in things if sum(thing.name == other.name for other in things) > 1}
    faults += [f"{name}: the name of several objects; rename them." for name in sorted(twice)]
    return [thing for thing in things if thing.name not in twice], faults


def albedo_images(files: list[Path]) -> list[Path]:
    """The images among `files`, or those of them whose names say albedo, in the clearest words there are."""
    images = [file for file in files if file.suffix.lower() in IMAGES]
    for word in ALBEDO_WORDS if len(images) > 1 else ():
        named = [image for image in images if word in image.stem.lower()]
        if named:
            return named
    return images


def choose_hdris(options: argparse.Namespace, wanted: Preset) -> tuple[list[str], list[str]]:
    """Names of the HDRIs for the photos and of those held out; the seed draws what is not named."""
    hdris = find_hdris(options.hdris)

    def named(names: list[str]) -> list[str]:
        return [file.stem for file in hdris_named(names, hdris).values()]

    training, held_out = named(options.train_hdris or []), named(options.held_out or [])
    shared = sorted(set(training) & set(held_out))
    if shared:
        sys.exit(f"{', '.join(shared)}: light the photos and are held out; choose.")
    drawn = [str(name) for name in np.random.default_rng(options.seed).permutation(sorted(hdris))]
    free = [name for name in drawn if name not in training and name not in held_out]
    if not held_out:
        held_out, free = free[: wanted.held_out_count], free[wanted.held_out_count :]
    training = training or free[: wanted.lightings]
    if len(held_out) < 2 or not training:
        sys.exit(
            f"{options.hdris}: {len(hdris)} HDRIs are too few; one for the photos and two held out are needed."
        )
    if len(training) < wanted.lightings:
        say(f"{wanted.lightings} lightings from {len(training)} HDRIs: some are used again, turned")
    return training, held_out


def seed_of(base: int, name: str) -> int:
    """The object's own seed: does not change with what other objects there are."""
    return int.from_bytes(hashlib.sha256(f"{base}/{name}".encode()).digest()[:4], "big") >> 2


def arguments(
    thing: Thing, options: argparse.Namespace, wanted: Preset, training: list[str], held_out: list[str]
) -> list[str]:
    """The command line of `render_scene.py` for one object."""
    values = {
        "mesh": thing.mesh,
        **({"texture": thing.texture} if thing.texture else {}),
        **{name: getattr(options, name) for name in ("up", "roughness", "specular")},
        **{name: getattr(wanted, name) for name in PASSED_ON},
        "hdris": options.hdris.resolve(),
        "seed": seed_of(options.seed, thing.name),
    }
    result = [str(options.out / thing.name)]
    for name, value in values.items():
        result += ["--" + name.replace("_", "-"), str(value)]
    return [*result, "--train-hdris", *training, "--held-out", *held_out]


class Progress:
    """How many pictures of all scenes are there, and how long the rest will take at the present pace."""

    def __init__(self, scenes: dict[str, Path], wanted: Preset, held_out: int) -> None:
        each = wanted.photos + wanted.test + wanted.relit_views * held_out
        self.total = each * len(scenes)
        self.missing = {name: each - pictures_in(scene) for name, scene in scenes.items()}
        self.rendered, self.start = 0, time.monotonic()

    def line(self, scene: str, picture: str) -> str:
        """To be called when `picture` of `scene` is begun."""
        left = sum(self.missing.values())
        pace = (time.monotonic() - self.start) / self.rendered if self.rendered else None
        self.missing[scene] -= 1
        self.rendered += 1
        ends = f", {span(pace * left)} left" if pace else ""
        return f"[{self.total - left + 1}/{self.total}] {scene} {picture}{ends}"

    def finish(self, scene: str) -> None:
        """`scene` is whole or given up: nothing more will come of it."""
        self.missing[scene] = 0


def pictures_in(scene: Path) -> int:
    files = [file for folder in ("train", "test") for file in (scene / folder).glob("*.png")]
    return sum(not file.stem.endswith(".partial") for file in files)


def span(seconds: float) -> str:
    """A rough length of time.

    >>> span(50), span(600), span(20000)
    ('50 s', '10 min', '5.6 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
