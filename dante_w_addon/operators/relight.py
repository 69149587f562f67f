"""Operators: preview under one HDRI, or a contact sheet of all. With a window, Blender stays usable meanwhile."""

from __future__ import annotations

import atexit

import bpy
import numpy as np
from bpy.props import BoolProperty

from ..blender import hdris, pictures, properties, studio
from ..bridge import job
from ..bridge.relighting import Relighting
from . import windows

PREVIEW = "DANTE-W relight"
SHEET = "DANTE-W contact sheet"
STILL_SIZE, TILE_SIZE = 640, 320  # pixels, the longer side

active: Relighting | None = None
last_message = ""
_name = ""  # of the picture that is on its way
_newest: tuple[str, np.ndarray] | None = None  # name and pixels of the picture that came last


def watch(relighting: Relighting, name: str) -> None:
    """Let the picture of `relighting` come into the file as `name` when it is finished."""
    global active, last_message, _name
    active, last_message, _name = relighting, "", name
    bpy.app.timers.register(tick, first_interval=job.TICK)


def tick() -> float | None:
    """Timer: take the picture in when it is finished."""
    global active, last_message
    if active is None:
        return None
    try:
        # What the user renders meanwhile must not see data change.
        going = active.update() or bpy.app.is_job_running("RENDER")
        if not going:
            keep(_name, active.pixels())
    except (RuntimeError, OSError) as error:
        last_message, going = f"{studio.reason(error)}.", False
    if not going:
        active.close()
        active = None
    job.redraw()
    return job.TICK if going else None


def keep(name: str, pixels: np.ndarray) -> None:
    """Put a finished picture into the file."""
    global _newest
    _newest = name, pixels
    pictures.keep_picture(name, pixels)


def latest_image() -> bpy.types.Image | None:
    """The newest picture, or one that was saved with the file."""
    names = (*(_newest or ())[:1], PREVIEW, SHEET)
    return next((bpy.data.images[name] for name in names if name in bpy.data.images), None)


class DANTEW_OT_relight(bpy.types.Operator):
    """Render a Cycles preview of the scene's camera under the HDRI, without the scene's lamps"""

    bl_idname = "dantew.relight"
    bl_label = "Preview"

    every: BoolProperty(
        name="Contact Sheet", description="All HDRIs that ship with Blender", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return "Render a small preview under every HDRI, as one picture" if properties.every else cls.__doc__

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        settings = properties.settings_of(context.scene)
        if not hasattr(context.scene, "cycles"):
            cls.poll_message_set("Turn on the Cycles add-on in the preferences")
        elif context.scene.camera is None:
            cls.poll_message_set("The scene has no camera to look through")
        elif active is not None or bpy.app.is_job_running("RENDER"):
            cls.poll_message_set("A render is running")
        elif hdris.file_of(settings.hdri, settings.hdri_file) is None:
            cls.poll_message_set("Choose an .hdr or .exr file")
        else:
            return True
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            with self._start(context) as relighting:
                pixels = relighting.wait()
        except RuntimeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        keep(self._picture_name(), pixels)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        try:
            watch(self._start(context), self._picture_name())
        except RuntimeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _start(self, context: bpy.types.Context) -> Relighting:
        settings = properties.settings_of(context.scene)
        size = TILE_SIZE if self.every else STILL_SIZE
        look = studio.Look(settings.rotation, settings.strength, settings.samples, size)
        one = hdris.file_of(settings.hdri, settings.hdri_file)
        return Relighting(context, list(hdris.presets().values()) if self.every else [one], look)

    def _picture_name(self) -> str:
        return SHEET if self.every else PREVIEW


class DANTEW_OT_cancel_relight(bpy.types.Operator):
    """Stop rendering; no picture is made"""

    bl_idname = "dantew.cancel_relight"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        stop()
        job.redraw()
        return {"FINISHED"}


class DANTEW_OT_open_image(bpy.types.Operator):
    """Open the picture in an image editor"""

    bl_idname = "dantew.open_image"
    bl_label = "Open"

    name: bpy.props.StringProperty()

    def execute(self, context: bpy.types.Context) -> set[str]:
        image = bpy.data.images.get(self.name)
        if image is None:
            self.report({"ERROR"}, f"There is no image {self.name}")
            return {"CANCELLED"}
        windows.open_editor(context, "IMAGE_EDITOR", image)
        return {"FINISHED"}


def stop() -> None:
    """End a relighting that runs: it is cancelled, the file is closed, Blender quits, or the add-on is turned off."""
    global active
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    if active is not None:
        active.close()
        active = None


@bpy.app.handlers.persistent
def _file_closes(*_: object) -> None:
    global _newest
    stop()
    _newest = None


@bpy.app.handlers.persistent
def _undone(*_: object) -> None:
    """The picture came without an undo step, so that redo stays possible: undo takes it away, and it is put back here."""
    if _newest is not None and _newest[0] not in bpy.data.images:
        pictures.keep_picture(*_newest)


def register() -> None:
    """End a relighting with its file and with Blender."""
    for handlers, function in _HANDLERS:
        handlers.append(function)
    atexit.register(stop)


def unregister() -> None:
    """Undo `register`."""
    _file_closes()
    for handlers, function in _HANDLERS:
        handlers.remove(function)
    atexit.unregister(stop)


_HANDLERS = (
    (bpy.app.handlers.load_pre, _file_closes),
    (bpy.app.handlers.undo_post, _undone),
    (bpy.app.handlers.redo_post, _undone),
)
CLASSES = (DANTEW_OT_relight, DANTEW_OT_cancel_relight, DANTEW_OT_open_image)
