"""Which lights a scene is seen under: lightings, HDRIs by name, and what a scene's test views were relit with.

Needs no bpy, so that the scripts that only start Blender can choose HDRIs too.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Lighting:
    """An HDRI turned about the vertical, and a sun lamp (irradiance 0: none). Angles in radians."""

    hdri: str
    rotation: float
    sun_irradiance: float = 0.0
    sun_azimuth: float = 0.0
    sun_elevation: float = 0.5 * math.pi


@dataclass(frozen=True)
class Gloss:
    """What an object's Principled BSDF has beside its albedo: roughness and "Specular IOR Level"."""

    roughness: float = 1.0
    specular: float = 0.0


#: The gloss of scenes whose truth.json names none. Found by rendering the true textures of four such scenes over a
#: grid of both values: this pair came nearest to their relit views on the mean of each, 1 to 18 dB nearer than a
#: diffuse material, and left gains per channel within about 1% of 1.
UNNAMED_GLOSS = Gloss(roughness=0.7, specular=0.3)


@dataclass(frozen=True)
class Relights:
    """How a scene's test views were relit: the held-out lightings, the gain of each by name, the gloss."""

    lights: list[Lighting]
    gains: dict[str, float]
    gloss: Gloss


def relights_of(scene: Path) -> Relights:
    """What SCENE's files say about its relit test views.

    Scenes of `render_scene.py` say it all. Where truth.json has no "relights", the lights are those that
    "relit_gain" names, with the HDRI unturned and no sun lamp: so were the scenes made that we know of.
    """
    test = json.loads((scene / "transforms_test.json").read_text(encoding="utf-8"))
    truth = json.loads((scene / "truth.json").read_text(encoding="utf-8"))
    gains = test["relit_gain"]
    if "relights" not in truth:
        return Relights([Lighting(name, 0.0) for name in gains], gains, UNNAMED_GLOSS)
    settings = truth["settings"]
    gloss = Gloss(float(settings["roughness"]), float(settings["specular"]))
    return Relights([Lighting(**entry) for entry in truth["relights"]], gains, gloss)


def find_hdris(folder: Path) -> dict[str, Path]:
    """Name and file of every HDRI in `folder`, by name."""
    files = (path for path in folder.iterdir() if path.suffix.lower() in (".exr", ".hdr"))
    return {path.stem: path for path in sorted(files)}


def hdris_named(names: list[str], hdris: dict[str, Path]) -> dict[str, Path]:
    """The file of each name: the HDRI called just that, or the only one whose name begins so."""
    found = {}
    for name in names:
        matches = [name] if name in hdris else [stem for stem in hdris if stem.startswith(name)]
        if len(matches) != 1:
            what = f"{len(matches)} HDRIs begin with" if matches else "no HDRI is called or begins with"
            sys.exit(
                f"{what} {name!r} (of {', '.join(hdris) or 'none'}); name the right folder with --hdris."
            )
        found[name] = hdris[matches[0]]
    return found
