"""The command in this process on the painted square of `square_scene`, at a small size: its lines, and how accurate its albedo is."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dante_w.commands.cli import main
from dante_w.contract.scene_folder import read_scene
from dante_w.core.color import srgb_from_linear_array
from dante_w.scene.images import read_texture, write_png
from small_settings import small_preset
from square_scene import albedo_at, photograph

SIZE = 64
SMALL = small_preset(SIZE)
FIELD = ("--irradiance", "field")
PLAN = [
    *("texture", "light", "normals", "directions", "samples", "memory", "time"),
    *("clusters", "exposures", "bounce", "specular", "sun"),
]
FIELD_PLAN = ["texture", "light", "samples", "memory", "albedo", "embedding", "exposures"]


class Result(NamedTuple):
    """A recovery that succeeded: its folder, and the lines that it printed."""

    folder: Path
    events: list[dict]

    @property
    def report(self) -> dict:
        return self.events[-1]["report"]


def run(*arguments: str | Path) -> tuple[int, list[dict]]:
    """Exit code and JSON lines of the command."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = main([*map(str, arguments), "--json"], settings=SMALL)
    return code, [json.loads(line) for line in out.getvalue().splitlines()]


def recover(scene: Path, folder: Path, *options: str | Path) -> Result:
    code, events = run("recover", scene, "--out", folder, *options)
    assert code == 0, events[-1]
    return Result(folder, events)


def accuracy(folder: Path, name: str = "albedo.png", gain: bool = False) -> float:
    """PSNR in dB of sRGB colours against the painted albedo, away from the rim; after one gain per channel."""
    centres = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(centres, 1.0 - centres)
    truth = albedo_at(np.stack([u, v], axis=-1))[6:-6, 6:-6]
    found = read_texture(folder / name)[6:-6, 6:-6]
    if gain:
        found = found * ((found * truth).sum((0, 1)) / (found**2).sum((0, 1)))
    error = srgb_from_linear_array(found.clip(0, 1)) - srgb_from_linear_array(truth)
    return float(-10.0 * np.log10((error**2).mean()))


def write_priors(scene: Path, folder: Path) -> Path:
    """What a faultless network would say of each photo."""
    folder.mkdir()
    for index, frame in enumerate(read_scene(scene).frames):
        unlit = photograph(frame.camera, frame.camera_to_world, gain=1.0, slope=0.0)
        write_png(folder / f"{index}.png", unlit)
    return folder
