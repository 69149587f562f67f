"""The command `dante-w`. See docs/architecture.md for its JSON lines and exit codes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from dante_w import __version__
from dante_w.errors import BAD_INPUT, DONE
from dante_w.job import run


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run, and return the exit code."""
    options = _parser().parse_args(arguments)
    if options.command == "doctor":
        from dante_w.doctor import examine

        print(json.dumps(examine()) if options.json else "\n".join(f"{k}: {v}" for k, v in examine().items()))
        return DONE
    return run(options.command, options)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="dante-w", description="Diffuse albedo textures from posed photos of a mesh.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True)
    recover = commands.add_parser("recover", help="recover the albedo texture of a scene")
    average = commands.add_parser("average", help="average the photos on the texture: light stays baked in")
    doctor = commands.add_parser("doctor", help="say which device, libraries and memory would be used")
    for command in (recover, average):
        command.add_argument("scene", type=Path, help="scene folder, or the parent of a COLMAP model")
        command.add_argument("--out", type=Path, required=True, help="folder for the result")
        command.add_argument("--mesh", type=Path, help="OBJ, PLY or GLB, if not the scene's own")
        command.add_argument("--images", type=Path, help="photos of a COLMAP model (default: images/)")
        command.add_argument("--texture-size", type=_size, metavar="N", help="texels a side (default 2048)")
        command.add_argument("--format", choices=("png", "png16", "exr"), default="png")
        command.add_argument("--unwrap", action="store_true", help="make new UVs; mesh.obj is written too")
    recover.add_argument("--priors", type=Path, metavar="DIR", help="albedo images named like the photos")
    recover.add_argument("--preset", choices=("draft", "standard", "high", "paper"), default="standard")
    recover.add_argument(
        "--irradiance",
        choices=("field", "traced"),
        default="field",
        help="light as the paper's field over space, or (new) traced through the mesh; no priors with that yet",
    )
    recover.add_argument(
        "--lambda", dest="prior_weight", type=_weight, default=1.0, metavar="X", help="prior weight"
    )
    recover.add_argument("--device", choices=("auto", "cpu", "cuda", "mps"), default="auto")
    recover.add_argument("--seed", type=int, default=0)
    recover.add_argument("--keep-held-out", action="store_true", help="never fit to the held-out photos")
    ablations = recover.add_argument_group("ablations of the paper")
    ablations.add_argument("--no-photometric", action="store_true", help="lift the priors only (w/o PR)")
    ablations.add_argument("--equal-bands", action="store_true", help="irradiance as fine as albedo")
    for command in (recover, average, doctor):
        command.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser


class _Parser(argparse.ArgumentParser):
    def error(self, message: str):  # type: ignore[no-untyped-def]
        if "--json" in sys.argv:
            print(json.dumps({"stage": "error", "code": BAD_INPUT, "message": message}), flush=True)
        super().error(message)


def _size(text: str) -> int:
    size = int(text)
    if not 1 <= size <= 16384:
        raise argparse.ArgumentTypeError("a texture is 1 to 16384 texels a side")
    return size


def _weight(text: str) -> float:
    weight = float(text)
    if not 0.0 <= weight < float("inf"):
        raise argparse.ArgumentTypeError("lambda is a number from 0 up")
    return weight
