"""The command without a window: export, recover, put the albedo on, save, relight.

Three ways lead here, with one meaning: `blender -c dante_w recover scene.blend --out DIR`,
`blender -b scene.blend --python batch.py -- --out DIR`, and `python batch.py scene.blend --out DIR` with the
bpy module. The exit codes are the backend's, see `contract.errors`.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..blender import hdris, pictures, studio
from ..blender.paths import file_name
from ..contract.errors import BAD_INPUT, BUG, CANCELLED, DONE, BadInput
from ..contract.protocol import Done, Failed, Step, encode
from ..contract.vocabulary import stage_title
from . import export, interpreter, recovery
from .headless_options import check, make_request, parse
from .process import Process
from .progress import Progress
from .relighting import Relighting


def main(arguments: Sequence[str]) -> int:
    """Run one recovery with these command-line arguments; returns the exit code. Never raises."""
    try:
        options = parse(arguments)
    except SystemExit as end:  # argparse has said why
        return end.code if isinstance(end.code, int) else BAD_INPUT
    try:
        return _run(options)
    except BadInput as error:
        return _fail(options, BAD_INPUT, str(error))
    except KeyboardInterrupt:
        return _fail(options, CANCELLED, "Cancelled.")
    except Exception as error:
        return _fail(options, BUG, f"{type(error).__name__}: {error}")


def _run(options: argparse.Namespace) -> int:
    check(options)
    if options.blend is not None:
        _open(options.blend)
    out = options.out.resolve()
    textured = _textured_file(out)
    lights = _lights(options.relight)
    obj = _mesh_object(options.object)
    request = make_request(options, obj, out)
    python = options.backend_python or interpreter.backend_python()
    if python is None:
        raise BadInput(
            f"No backend Python was found; name it with --backend-python or {interpreter.VARIABLE}."
        )
    export.export_scene(bpy.context.scene, obj, bpy.context.evaluated_depsgraph_get(), request.scene)
    try:
        process = Process(interpreter.command(python, request.arguments()))
    except OSError as error:
        raise BadInput(f"{python} cannot be started: {error.strerror}.") from error
    progress = _follow(process, options.json)
    if progress.state != "done":
        return _fail(options, progress.code, progress.message)
    target = recovery.put_on(obj, out, options.pack)
    bpy.ops.wm.save_as_mainfile(filepath=str(textured), copy=True, compress=True)
    if lights:
        _relight(lights, options, out / "relight.png")
    message = Done(progress.report, str(out), target.name)
    print(encode(message) if options.json else f"Done: {out}", flush=True)
    return DONE


def _textured_file(out: Path) -> Path:
    """Where the scene is saved with its texture: never over the scene itself."""
    opened = bpy.data.filepath
    target = out / f"{file_name(Path(opened).stem or 'scene')}.blend"
    if opened and target.exists() and target.samefile(opened):
        raise BadInput(f"{target}: this is the scene itself; choose another folder as --out.")
    return target


def _open(path: Path) -> None:
    if not path.is_file():
        raise BadInput(f"{path}: no such file; name a .blend.")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise BadInput(f"{path}: not a .blend that this Blender can open.") from error


def _mesh_object(name: str | None) -> bpy.types.Object:
    meshes = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    active = bpy.context.view_layer.objects.active
    if name is not None:
        mesh = next((obj for obj in meshes if obj.name == name), None)
        if mesh is None:
            raise BadInput(f"The scene has no mesh named {name}; correct --object.")
        return mesh
    if active in meshes:
        return active
    if len(meshes) != 1:
        raise BadInput(f"The scene has {len(meshes)} meshes; name one with --object.")
    return meshes[0]


def _lights(choice: str | None) -> list[Path]:
    if choice is None:
        return []
    if choice == "all":
        return list(hdris.presets().values())
    path = hdris.file_of(choice, "") or hdris.file_of(hdris.OWN, os.path.abspath(choice))
    if path is None:
        names = ", ".join(hdris.presets())
        raise BadInput(f"{choice}: no such HDRI; name an .hdr or .exr file, or one of {names}.")
    if bpy.context.scene.camera is None:
        raise BadInput("The scene has no camera to relight from; set one, or leave --relight out.")
    return [path]


def _relight(lights: list[Path], options: argparse.Namespace, target: Path) -> None:
    def report(index: int) -> None:
        step = Step("relight", index, len(lights))
        text = encode(step) if options.json else f"Relighting {index + 1} of {len(lights)}"
        print(text, flush=True)

    look = studio.Look(samples=options.samples, size=options.size)
    with Relighting(bpy.context, lights, look) as relighting:
        image = pictures.keep_picture("DANTE-W relight", relighting.wait(report))
    image.filepath_raw, image.file_format = str(target), "PNG"
    image.save()


def _follow(process: Process, as_json: bool) -> Progress:
    """Wait for the backend and print its progress; end it when this process is asked to end."""
    progress = Progress()
    signals = (signal.SIGINT, signal.SIGTERM)
    handlers = {number: signal.signal(number, lambda *_: process.cancel()) for number in signals}
    latest = ""
    try:
        while progress.state == "running":
            for message in progress.follow(process):
                if as_json and not isinstance(message, Done | Failed):  # ours come later
                    print(encode(message), flush=True)
            text = f"{stage_title(progress.step.stage)}  {progress.step.fraction:.0%}"
            if not as_json and text != latest:
                print(text, flush=True)
                latest = text
            time.sleep(0.1)
    finally:
        process.close()
        for number, handler in handlers.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: Blender's own
    return progress


def _fail(options: argparse.Namespace, code: int, message: str) -> int:
    if options.json:
        print(encode(Failed(code, message)), flush=True)
    print(message, file=sys.stderr, flush=True)
    return code
