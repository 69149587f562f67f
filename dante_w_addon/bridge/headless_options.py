"""The options of the command without a window, and what they ask of the backend."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..blender import known_colours
from ..contract.command import Request
from ..contract.errors import BadInput
from ..contract.vocabulary import COMPONENTS, DEVICES, FORMATS, MODEL_PRESETS, MODELS, PRESETS, component


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of a command line; the command's name, `recover`, may stand before them.

    Raises:
        SystemExit: they make no sense; the reason has been printed.
    """
    return _parser().parse_args(arguments[1:] if arguments and arguments[0] == "recover" else arguments)


def check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other.

    Raises:
        BadInput: they do; the message names them and the fix.
    """
    if options.preset not in MODEL_PRESETS[options.irradiance]:
        others = ", ".join(MODEL_PRESETS[options.irradiance])
        raise BadInput(f"--preset {options.preset} needs --irradiance field; without it choose {others}.")
    if options.known and options.unwrap:
        raise BadInput("--known names places on the present UV map; leave out --unwrap.")


def make_request(options: argparse.Namespace, obj: bpy.types.Object, out: Path) -> Request:
    """What the options ask of the backend for `obj`; the result goes to `out`, the scene into a folder in it.

    Raises:
        BadInput: the object's known colours cannot be used.
    """
    return Request(
        scene=out / "scene",
        out=out,
        model=options.irradiance,
        preset=options.preset,
        texture_size=options.texture_size,
        file_format=options.format,
        device=options.device,
        priors=Path(options.priors).resolve() if options.priors else None,
        unwrap=options.unwrap,
        known=_known_colours(options, obj),
        components=tuple(component(word).key for word in options.model),
        left_out=tuple(component(word).key for word in options.leave_out),
    )


def _known_colours(options: argparse.Namespace, obj: bpy.types.Object) -> tuple[tuple[str, str, str], ...]:
    if options.known:
        return tuple(tuple(spot) for spot in options.known)
    if not hasattr(obj, "dante_w_known_colours"):  # batch.py, where the add-on is off
        known_colours.register()
    problem = known_colours.problem(obj, options.unwrap)
    if problem:
        raise BadInput(problem)
    return known_colours.as_words(obj)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dante_w recover",
        description="Recover the albedo texture of a mesh from photos, without a window.",
    )
    parser.add_argument("blend", nargs="?", type=Path, help="file to open (default: the one that is open)")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for the result and the textured .blend"
    )
    parser.add_argument("--object", help="mesh to texture (default: the active one, or the only one)")
    parser.add_argument("--preset", default="standard", choices=PRESETS, help="quality against time")
    parser.add_argument("--texture-size", type=int, default=0, metavar="N", help="texels along a side")
    parser.add_argument("--format", default="png", choices=FORMATS, help="file format of the albedo")
    parser.add_argument("--priors", default="", metavar="DIR", help="albedo images named like the photos")
    parser.add_argument("--unwrap", action="store_true", help="make new UVs")
    parser.add_argument(
        "--known",
        nargs=3,
        action="append",
        metavar=("U", "V", "COLOUR"),
        help="albedo at a texture coordinate: grey, or #RRGGBB (default: the spots picked on the mesh)",
    )
    parser.add_argument("--irradiance", default="traced", choices=MODELS, help="how light is modelled")
    parser.add_argument("--device", default="auto", choices=DEVICES, help="for --irradiance field")
    words = [word for item in COMPONENTS for word in dict.fromkeys((item.name, item.key))]
    for option, meaning in (
        ("--model", "always model this component of the light"),
        ("--leave-out", "never model it"),
    ):
        parser.add_argument(option, action="append", default=[], choices=words, help=meaning)
    parser.add_argument("--pack", action="store_true", help="keep the images inside the .blend")
    parser.add_argument("--relight", metavar="HDRI", help="a preset's name, an .hdr/.exr file, or 'all'")
    parser.add_argument("--samples", type=int, default=32, help="Cycles samples of the relight preview")
    parser.add_argument("--size", type=int, default=640, help="pixels of its longer side")
    parser.add_argument(
        "--backend-python",
        metavar="PYTHON",
        help="the backend's interpreter (default: as in the preferences)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per line")
    return parser
