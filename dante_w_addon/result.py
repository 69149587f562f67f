"""From a whole result folder to a textured object: what the panel and the headless command share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy

from . import material, unwrap
from .paths import launcher


def recover_command(
    python: str,
    scene: Path,
    out: Path,
    *,
    preset: str,
    texture_size: int = 0,
    device: str = "auto",
    file_format: str = "png",
    priors: str = "",
    unwrap_mesh: bool = False,
    extra: Sequence[str] = (),
) -> list[str]:
    """The command line that recovers `scene` into `out`; see docs/architecture.md."""
    command = [
        python,
        "-I",
        "-X",
        "utf8",
        str(launcher()),
        "recover",
        str(scene),
        "--out",
        str(out),
        "--json",
    ]
    command += ["--preset", preset, "--device", device, "--format", file_format]
    if texture_size:
        command += ["--texture-size", str(texture_size)]
    if priors:
        command += ["--priors", priors]
    if unwrap_mesh:
        command.append("--unwrap")
    return [*command, *extra]


def take_in(obj: bpy.types.Object, out: Path, pack: bool) -> bpy.types.Object:
    """Put a result on `obj`; returns the textured object, a new one where new UVs do not fit `obj`."""
    unwrapped = out / "mesh.obj"
    if unwrapped.is_file():
        obj = unwrap.bring_back(obj, unwrapped)
    material.apply(obj, out, pack)
    return obj
