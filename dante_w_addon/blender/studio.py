"""Cycles previews of a scene under HDRIs, rendered by a Blender of their own from a copy of the scene.

So undo, saving, deleting and loading meanwhile cannot meet a render, and nothing of it comes into the user's file. The
user's Blender calls `write_copy`. The other one runs this file as a script, with the folder of the copy as its argument:
it writes 0.png, 1.png, ... there and says so, one JSON object a line. Hence no imports from the add-on.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

LEFT_OUT = {"LIGHT", "CAMERA", "LIGHT_PROBE", "SPEAKER"}
SCENE, JOB = "scene.blend", "job.json"  # in the folder of a copy


@dataclass(frozen=True)
class Look:
    """How a preview is lit and rendered. `rotation` in radians, `size` the longer side in pixels."""

    rotation: float = 0.0
    strength: float = 1.0
    samples: int = 32
    size: int = 640


def can_denoise() -> bool:
    """Whether this build of Blender has OpenImageDenoise; some distributions leave it out."""
    try:
        import _cycles

        return bool(_cycles.with_openimagedenoise)
    except (ImportError, AttributeError):
        return False


def reason(error: Exception) -> str:
    """What went wrong, in one line without a full stop."""
    if isinstance(error, OSError) and error.strerror:
        return ": ".join(str(part) for part in (error.strerror, error.filename) if part)
    said = str(error).strip().splitlines() or [type(error).__name__]
    return said[-1].removeprefix("Error: ").rstrip(".")


# ---- the user's Blender ----------------------------------------------------------------------------------


def write_copy(context: bpy.types.Context, folder: Path, lights: list[Path], look: Look) -> None:
    """Write the scene as it is now, saved or not, and how to render it under each of `lights`, into `folder`.

    The scene is written like an asset, with all that it uses: that calls no save handlers, packs nothing and leaves
    the user's file and its "unsaved" mark alone, as saving a copy would not.

    Raises:
        OSError, RuntimeError: the copy cannot be written.
    """
    bpy.ops.ed.flush_edits()  # what is being edited or sculpted
    scene = context.scene
    bpy.data.libraries.write(str(folder / SCENE), {scene}, path_remap="ABSOLUTE", compress=False)
    job = {
        "scene": scene.name,
        "view_layer": context.view_layer.name,
        "lights": [os.path.abspath(light) for light in lights],
        "look": asdict(look),
        "pixels": _write_pixels(folder),
        "cycles": _cycles_preferences(),
    }
    (folder / JOB).write_text(json.dumps(job), encoding="utf-8")


def _write_pixels(folder: Path) -> dict[str, dict[str, Any]]:
    """Write the pixels that images have in memory alone, painted or made by a script; returns name -> file and size.

    Of images of many tiles Python reads the first alone: those are rendered as they were saved.
    """
    found = {}
    for image in bpy.data.images:
        if image.is_dirty and image.source in {"FILE", "GENERATED"} and image.library is None:
            pixels = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(pixels)
            file = folder / f"{len(found)}.pixels"
            pixels.tofile(file)
            found[image.name] = {"file": file.name, "size": [*image.size], "float": image.is_float}
    return found


def _cycles_preferences() -> dict[str, Any]:
    """The user's choice of devices, and the other settings of Cycles in the preferences."""
    preferences = bpy.context.preferences.addons["cycles"].preferences
    return {
        "settings": {
            entry.identifier: getattr(preferences, entry.identifier)
            for entry in preferences.bl_rna.properties
            if entry.type in {"BOOLEAN", "INT", "ENUM"} and not entry.is_readonly
        },
        "devices": {device.id: device.use for device in preferences.devices},
    }


# ---- the Blender that renders ------------------------------------------------------------------------------


def main(folder: Path) -> int:
    """Render what lies in `folder`; returns the exit code."""
    try:
        render_copy(folder)
    except Exception as error:
        say(stage="error", code=1, message=reason(error))
        return 1
    return 0


def say(**message: Any) -> None:
    """Write a line for the user's Blender. The first newline ends a line of Cycles' that is written but in part."""
    print("\n" + json.dumps(message), flush=True)


def render_copy(folder: Path) -> None:
    """Render the copy in `folder` under each of its lights, one after the other."""
    job = json.loads((folder / JOB).read_text(encoding="utf-8"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / SCENE), load_ui=False, use_scripts=False)
    _read_pixels(job["pixels"], folder)
    user = bpy.data.scenes[job["scene"]]
    if user.cycles.device != "CPU":
        _use_devices(job["cycles"])
    look, lights = Look(**job["look"]), job["lights"]
    scene = studio_scene(user, user.view_layers[job["view_layer"]], look)
    for index, light in enumerate(lights):
        say(stage="relight", step=index, total=len(lights))
        scene.world = lit_world(Path(light), look)
        scene.render.filepath = str(folder / f"{index}.png")
        bpy.ops.render.render(write_still=True, scene=scene.name)
    say(stage="relight", step=len(lights), total=len(lights))


def studio_scene(user: bpy.types.Scene, layer: bpy.types.ViewLayer, look: Look) -> bpy.types.Scene:
    """A scene with what the user sees, without the lamps, and with plain render settings."""
    scene = bpy.data.scenes.new("Studio")
    objects = [
        obj
        for obj in layer.objects
        if obj.type not in LEFT_OUT and not obj.hide_render and obj.visible_get(view_layer=layer)
    ]
    for obj in dict.fromkeys([*objects, user.camera]):
        scene.collection.objects.link(obj)
    scene.camera = user.camera
    scene.frame_current = user.frame_current
    _render_settings(scene.render, user.render, look)
    for name in ("view_transform", "look", "exposure", "gamma"):
        setattr(scene.view_settings, name, getattr(user.view_settings, name))
    cycles = scene.cycles
    cycles.device = user.cycles.device
    cycles.samples = look.samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = can_denoise()
    if cycles.use_denoising:
        cycles.denoiser = "OPENIMAGEDENOISE"
    return scene


def _render_settings(render: Any, source: Any, look: Look) -> None:
    render.engine = "CYCLES"
    longer = max(source.resolution_x, source.resolution_y)
    render.resolution_x = max(round(source.resolution_x * look.size / longer), 4)
    render.resolution_y = max(round(source.resolution_y * look.size / longer), 4)
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = source.pixel_aspect_x, source.pixel_aspect_y
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGB"
    render.use_file_extension = False


def lit_world(hdri: Path, look: Look) -> bpy.types.World:
    """A world whose light is `hdri`."""
    world = bpy.data.worlds.new("Studio")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    names = ("TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld")
    coordinates, mapping, environment, background, output = (
        tree.nodes.new(f"ShaderNode{name}") for name in names
    )
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], environment.inputs["Vector"])
    tree.links.new(environment.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    environment.image = bpy.data.images.load(str(hdri))
    environment.image.colorspace_settings.name = "Linear Rec.709"
    mapping.inputs["Rotation"].default_value[2] = look.rotation
    background.inputs["Strength"].default_value = look.strength
    return world


def _read_pixels(written: dict[str, dict[str, Any]], folder: Path) -> None:
    """Put the pixels of `_write_pixels` in the place of what the file has."""
    for name, entry in written.items():
        old, (width, height) = bpy.data.images.get((name, None)), entry["size"]
        if old is None:  # nothing in the scene uses it
            continue
        new = bpy.data.images.new(name, width, height, alpha=True, float_buffer=entry["float"])
        new.colorspace_settings.name, new.alpha_mode = old.colorspace_settings.name, old.alpha_mode
        pixels = np.fromfile(folder / entry["file"], np.float32).reshape(height, width, -1)
        filled = np.ones((height, width, 4), np.float32)
        filled[..., : max(pixels.shape[-1], 3)] = pixels  # grey has one channel
        new.pixels.foreach_set(filled.ravel())
        old.user_remap(new)


def _use_devices(cycles: dict[str, Any]) -> None:
    """Render on the devices that the user chose."""
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for name, value in cycles["settings"].items():
        with contextlib.suppress(TypeError):  # a kind of device that is no longer there
            setattr(preferences, name, value)
    preferences.refresh_devices()
    for device in preferences.devices:
        device.use = cycles["devices"].get(device.id, device.use)


if __name__ == "__main__":
    os._exit(
        main(Path(sys.argv[-1]))
    )  # not through Blender's own end, which may crash and has nothing to save
