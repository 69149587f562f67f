"""The command `dante-w`. See docs/architecture.md for its JSON lines and exit codes."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dante_w import __version__
from dante_w.commands.worker import run
from dante_w.contract.errors import BAD_INPUT, DONE
from dante_w.contract.known_colour import parse_known_colour
from dante_w.contract.protocol import Failed, encode
from dante_w.contract.vocabulary import COMPONENTS, DEVICES, FORMATS, LARGEST_TEXTURE, MODELS, PRESETS
from dante_w.options import Call, RecoverOptions
from dante_w.run import distributed

if TYPE_CHECKING:  # it imports torch, which takes seconds: signals come first
    from dante_w.presets import Preset

#: Words for the components of the light, old ones too.
COMPONENT_WORDS = sorted({word for each in COMPONENTS for word in (each.name, each.key)})


def main(
    arguments: Sequence[str] | None = None,
    leave: Callable[[int], Any] = os._exit,
    settings: Preset | None = None,
) -> int:
    """Parse, run, and return the exit code, or call `leave` with it, see `worker.run`; `settings` take the place of the preset's."""
    call = parse(arguments)
    if call.command == "doctor":
        from dante_w.commands.doctor import examine

        print(json.dumps(examine()) if call.json else "\n".join(f"{k}: {v}" for k, v in examine().items()))
        return DONE
    return run(call, leave, settings)


def parse(arguments: Sequence[str] | None = None) -> Call:
    """What a command line asks for; raises SystemExit where it makes no sense."""
    words = vars(_parser().parse_args(arguments))
    command, as_json = words.pop("command"), words.pop("json")
    words = {name: tuple(value) if isinstance(value, list) else value for name, value in words.items()}
    return Call(command, RecoverOptions(**{"scene": Path(), **words}), as_json)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="dante-w", description="Diffuse albedo textures from posed photos of a mesh.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True)
    recover = commands.add_parser("recover", help="recover the albedo texture of a scene")
    plan = commands.add_parser("plan", help="say what recover would model of a scene, and why")
    average = commands.add_parser("average", help="average the photos on the texture: light stays baked in")
    doctor = commands.add_parser("doctor", help="say which device, libraries and memory would be used")
    for command in (recover, average, plan):
        command.add_argument("scene", type=Path, help="scene folder, or the parent of a COLMAP model")
        command.add_argument("--mesh", type=Path, help="OBJ, PLY or GLB, if not the scene's own")
        command.add_argument("--images", type=Path, help="photos of a COLMAP model (default: images/)")
        command.add_argument(
            "--texture-size", type=_size, metavar="N", help="texels a side (default: as fine as the photos)"
        )
        command.add_argument("--format", choices=FORMATS, default="png")
        command.add_argument("--unwrap", action="store_true", help="make new UVs; mesh.obj is written too")
    for command in (recover, average):
        command.add_argument("--out", type=Path, required=True, help="folder for the result")
    for command in (recover, plan):
        command.add_argument("--priors", type=Path, metavar="DIR", help="albedo images named like the photos")
        command.add_argument("--preset", choices=PRESETS, default="standard")
        command.add_argument(
            "--lambda", dest="prior_weight", type=_weight, default=1.0, metavar="X", help="prior weight"
        )
        command.add_argument("--seed", type=int, default=0)
        command.add_argument(
            "--irradiance",
            choices=MODELS,
            help="light traced through the mesh (default), or the paper's field over space",
        )
        for option, name, help_text in (
            ("--model", "model", "model this part of the light whatever the plan finds (repeatable)"),
            ("--leave-out", "leave_out", "do not model this part (repeatable)"),
        ):
            command.add_argument(
                option, dest=name, action="append", choices=COMPONENT_WORDS, default=[], help=help_text
            )
    recover.add_argument(
        "--known",
        nargs=3,
        action=_Known,
        default=[],
        metavar=("U", "V", "COLOUR"),
        help="albedo at a texture coordinate: grey, or sRGB like #7A7A79 (repeatable)",
    )
    recover.add_argument(
        "--device",
        choices=DEVICES,
        default="auto",
        help="for --irradiance field (auto: a GPU if one works); traced light always runs on the CPU",
    )
    recover.add_argument(
        "--resume", action="store_true", help="go on from where a killed run of the same got to"
    )
    recover.add_argument("--keep-held-out", action="store_true", help="never fit to the held-out photos")
    ablations = recover.add_argument_group("ablations of the paper")
    ablations.add_argument("--no-photometric", action="store_true", help="lift the priors only (w/o PR)")
    ablations.add_argument("--equal-bands", action="store_true", help="irradiance as fine as albedo")
    for command in (recover, average, plan, doctor):
        command.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser


class _Known(argparse.Action):
    """Appends a `KnownColour`."""

    def __call__(self, parser, namespace, values, option_string=None):  # type: ignore[no-untyped-def]
        try:
            setattr(namespace, self.dest, [*getattr(namespace, self.dest), parse_known_colour(*values)])
        except ValueError as error:
            parser.error(f"argument {option_string}: {error}")


class _Parser(argparse.ArgumentParser):
    def error(self, message: str):  # type: ignore[no-untyped-def]
        if "--json" in sys.argv and distributed.rank() == 0:
            print(encode(Failed(BAD_INPUT, message)), flush=True)
        super().error(message)


def _size(text: str) -> int:
    size = int(text)
    if not 1 <= size <= LARGEST_TEXTURE:
        raise argparse.ArgumentTypeError(f"a texture is 1 to {LARGEST_TEXTURE} texels a side")
    return size


def _weight(text: str) -> float:
    weight = float(text)
    if not 0.0 <= weight < float("inf"):
        raise argparse.ArgumentTypeError("lambda is a number from 0 up")
    return weight
