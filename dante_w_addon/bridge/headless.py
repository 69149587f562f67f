"""The command without a window: export, recover, put the albedo on, save, relight.

Three ways lead here, with one meaning: `blender -c dante_w recover scene.blend --out DIR`,
`blender -b scene.blend --python batch.py -- --out DIR`, and `python batch.py scene.blend --out DIR` with the
bpy module. The exit codes are the backend's: 0 done, 2 bad input, 3 cancelled, 4 out of memory or disk, 1 else.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..blender import hdris, known_colours, properties, studio
from ..blender.paths import file_name
from ..contract import scene_folder
from . import export, interpreter, result
from .process import Process, Progress

DONE, BUG, BAD_INPUT, CANCELLED = 0, 1, 2, 3


def main(arguments: Sequence[str]) -> int:
    """Run one recovery as `arguments` say; returns the exit code. Never raises."""
    try:
        options = _parser().parse_args(_without_command(arguments))
    except SystemExit as end:  # argparse has said why
        return end.code if isinstance(end.code, int) else BAD_INPUT
    try:
        return _run(options)
    except scene_folder.BadInput as error:
        return _fail(options, BAD_INPUT, str(error))
    except KeyboardInterrupt:
        return _fail(options, CANCELLED, "Cancelled.")
    except Exception as error:
        return _fail(options, BUG, f"{type(error).__name__}: {error}")


def _without_command(arguments: Sequence[str]) -> list[str]:
    """The one command, `recover`, may be named or not."""
    return list(arguments[1:] if arguments and arguments[0] == "recover" else arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dante_w recover",
        description="Recover the albedo texture of a mesh from photos, without a window.",
    )
    parser.add_argument("blend", nargs="?", type=Path, help="scene to open (default: the one that is open)")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for the result and the textured .blend"
    )
    parser.add_argument("--object", help="mesh to texture (default: the active one, or the only one)")
    parser.add_argument("--preset", default="standard", choices=("draft", "standard", "high", "paper"))
    parser.add_argument("--texture-size", type=int, default=0, metavar="N", help="texels a side")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda", "mps"))
    parser.add_argument("--format", default="png", choices=("png", "png16", "exr"))
    parser.add_argument("--priors", default="", metavar="DIR", help="albedo images named like the photos")
    parser.add_argument("--unwrap", action="store_true", help="make new UVs")
    parser.add_argument(
        "--known",
        nargs=3,
        action="append",
        metavar=("U", "V", "COLOUR"),
        help="albedo known at a texture coordinate: grey, or #RRGGBB (default: the spots picked on the mesh)",
    )
    parser.add_argument(
        "--irradiance", default="traced", choices=("traced", "field"), help="how light is modelled"
    )
    for option, words in (
        ("--model", "model this part of the light in any case"),
        ("--leave-out", "never model it"),
    ):
        parser.add_argument(option, action="append", default=[], choices=tuple(properties.PARTS), help=words)
    parser.add_argument("--pack", action="store_true", help="keep the images inside the .blend")
    parser.add_argument("--relight", metavar="HDRI", help="a preset's name, an .hdr/.exr file, or 'all'")
    parser.add_argument("--samples", type=int, default=32, help="Cycles samples of the relight preview")
    parser.add_argument("--size", type=int, default=640, help="pixels of its longer side")
    parser.add_argument(
        "--backend-python",
        metavar="PYTHON",
        help="the backend's interpreter (default: as in the preferences)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.blend is not None:
        _open(options.blend)
    out = options.out.resolve()
    lights = _lights(options.relight)
    obj = _mesh_object(options.object)
    known = _known(options, obj)
    python = options.backend_python or interpreter.backend_python()
    if python is None:
        raise scene_folder.BadInput(
            f"No backend Python was found; name it with --backend-python or {interpreter.VARIABLE}."
        )
    export.export_scene(bpy.context.scene, obj, bpy.context.evaluated_depsgraph_get(), out / "scene")
    command = result.recover_command(
        python,
        out / "scene",
        out,
        preset=options.preset,
        texture_size=options.texture_size,
        device=options.device,
        file_format=options.format,
        priors=str(Path(options.priors).resolve()) if options.priors else "",
        unwrap_mesh=options.unwrap,
        known=known,
        irradiance=options.irradiance,
        model=options.model,
        leave_out=options.leave_out,
    )
    try:
        process = Process(command)
    except OSError as error:
        raise scene_folder.BadInput(f"{python} cannot be started: {error.strerror}.") from error
    progress = _follow(process, options.json)
    if progress.state != "done":
        return _fail(options, progress.code, progress.message)
    textured = result.take_in(obj, out, options.pack)
    name = file_name(Path(bpy.data.filepath).stem or "scene")
    bpy.ops.wm.save_as_mainfile(filepath=str(out / f"{name}.blend"), copy=True, compress=True)
    if lights:
        _relight(lights, options, out / "relight.png")
    _say(options, {"stage": "done", "out": str(out), "object": textured.name, "report": progress.report})
    return DONE


def _open(path: Path) -> None:
    if not path.is_file():
        raise scene_folder.BadInput(f"{path}: no such file; name a .blend.")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise scene_folder.BadInput(f"{path}: not a .blend that this Blender can open.") from error


def _mesh_object(name: str | None) -> bpy.types.Object:
    meshes = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    active = bpy.context.view_layer.objects.active
    if name is not None:
        chosen = next((obj for obj in meshes if obj.name == name), None)
        if chosen is None:
            raise scene_folder.BadInput(f"The scene has no mesh named {name}; correct --object.")
        return chosen
    if active in meshes:
        return active
    if len(meshes) != 1:
        raise scene_folder.BadInput(f"The scene has {len(meshes)} meshes; name one with --object.")
    return meshes[0]


def _known(options: argparse.Namespace, obj: bpy.types.Object) -> Sequence[Sequence[str]]:
    if options.known and options.unwrap:
        raise scene_folder.BadInput("--known names places on the present UV map; leave out --unwrap.")
    if options.known:
        return options.known
    if not hasattr(obj, "dante_w_known_colours"):  # batch.py, where the add-on is off
        known_colours.register()
    problem = known_colours.problem(obj, options.unwrap)
    if problem:
        raise scene_folder.BadInput(problem)
    return known_colours.words(obj)


def _lights(choice: str | None) -> list[Path]:
    if choice is None:
        return []
    if choice == "all":
        return studio.default_lights()
    path = hdris.file_of(choice, "") or hdris.file_of(hdris.OWN, os.path.abspath(choice))
    if path is None:
        names = ", ".join(hdris.presets())
        raise scene_folder.BadInput(f"{choice}: no such HDRI; name an .hdr or .exr file, or one of {names}.")
    if bpy.context.scene.camera is None:
        raise scene_folder.BadInput(
            "The scene has no camera to relight from; set one, or leave --relight out."
        )
    return [path]


def _relight(lights: list[Path], options: argparse.Namespace, target: Path) -> None:
    look = studio.Look(samples=options.samples, size=options.size)
    with studio.Studio(bpy.context, look) as borrowed, studio.temporary_folder() as folder:

        def say(index: int) -> None:
            _say(options, {"stage": "relight", "step": index, "total": len(lights)})

        picture = studio.render_all(borrowed, lights, folder, say)
        image = studio.keep_picture("DANTE-W relight", picture)
        image.filepath_raw, image.file_format = str(target), "PNG"
        image.save()


def _follow(process: Process, as_json: bool) -> Progress:
    """Wait for the backend, pass its lines on, and end it when we are asked to end."""
    progress = Progress()
    asked = (signal.SIGINT, signal.SIGTERM)
    former = {number: signal.signal(number, lambda *_: process.cancel()) for number in asked}
    last = None
    try:
        while progress.state == "running":
            for message in progress.follow(process):
                if as_json and message["stage"] not in ("done", "error"):
                    print(json.dumps(message), flush=True)
            line = f"{progress.stage} {progress.fraction:.0%}"
            if not as_json and line != last:
                print(line, flush=True)
                last = line
            time.sleep(0.1)
    finally:
        if process.returncode is None and not process.cancelled:
            process.kill()
        for number, handler in former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: Blender's own
    return progress


def _say(options: argparse.Namespace, message: dict) -> None:
    if options.json:
        print(json.dumps(message), flush=True)
    elif message["stage"] == "done":
        print(f"Done: {message['out']}", flush=True)
    else:
        print(f"{message['stage']} {message['step'] + 1} of {message['total']}", flush=True)


def _fail(options: argparse.Namespace, code: int, message: str) -> int:
    if options.json:
        print(json.dumps({"stage": "error", "code": code, "message": message}), flush=True)
    print(message, file=sys.stderr, flush=True)
    return code
