"""From a whole result folder to a textured object: what the panel and the headless command share."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

import bpy

from .. import layout
from ..blender import material, uv_back


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
    known: Sequence[Sequence[str]] = (),
    irradiance: str = "traced",
    model: Sequence[str] = (),
    leave_out: Sequence[str] = (),
) -> list[str]:
    """The command line that recovers `scene` into `out`; see docs/architecture.md. `known`: U, V, COLOUR each; `model`
    and `leave_out`: parts of the light."""
    command = [
        python,
        "-I",
        "-X",
        "utf8",
        str(layout.launcher()),
        "recover",
        str(scene),
        "--out",
        str(out),
        "--json",
    ]
    command += ["--preset", preset, "--device", device, "--format", file_format]
    command += ["--irradiance", irradiance]
    if texture_size:
        command += ["--texture-size", str(texture_size)]
    if priors:
        command += ["--priors", priors]
    if unwrap_mesh:
        command.append("--unwrap")
    for spot in known:
        command += ["--known", *spot]
    for option, parts in (("--model", model), ("--leave-out", leave_out)):
        for part in parts:
            command += [option, part]
    return command


def take_in(obj: bpy.types.Object, out: Path, pack: bool) -> bpy.types.Object:
    """Put a result on `obj`.

    Returns:
        The textured object: a new one, with `obj` hidden, where new UVs do not fit `obj`.

    Raises:
        OSError, ValueError: the folder is not a whole result.
    """
    settings = material.read_report(out).get("settings", {})  # files of a former run may lie beside
    textured = uv_back.bring_back(obj, out / "mesh.obj") if settings.get("unwrap") else obj
    material.apply(textured, out, pack)
    if textured != obj:
        obj.hide_render = True
        with contextlib.suppress(RuntimeError):  # it is in no collection of this view layer
            obj.hide_set(True)
    return textured
