"""Operators: preview under one HDRI, or a contact sheet of all. With a window, Blender stays usable meanwhile."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty

from ..blender import hdris, properties, studio
from ..bridge import job
from . import windows

PREVIEW = "DANTE-W relight"
SHEET = "DANTE-W contact sheet"
STILL_SIZE, TILE_SIZE = 640, 320  # pixels, the longer side
THUMBNAIL = 256  # pixels, as large as Blender's previews get


class Relighting:
    """Renders that follow each other while the user works on."""

    def __init__(self, studio: studio.Studio, lights: list[Path], name: str) -> None:
        self.studio, self.lights, self.name = studio, lights, name
        self.files: list[Path] = []
        self.folder = Path(tempfile.mkdtemp(prefix="dante_w_", dir=bpy.app.tempdir))
        self.message = ""

    @property
    def target(self) -> Path:
        return self.folder / f"{len(self.files)}.png"

    def start_next(self) -> None:
        """Start one render in the background, with no window of its own."""
        self.studio.light(self.lights[len(self.files)], self.target)
        view = bpy.context.preferences.view
        kept = view.render_display_type
        view.render_display_type = "NONE"
        try:
            with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
                bpy.ops.render.render("INVOKE_DEFAULT", write_still=True, scene=self.studio.scene.name)
        finally:
            view.render_display_type = kept

    def look(self) -> bool:
        """Take a finished render in and start the next. Returns: still at work."""
        if bpy.app.is_job_running("RENDER"):
            return True
        if not self.target.is_file():
            self.message = "The preview was stopped."
            return self.close()
        self.files.append(self.target)
        if len(self.files) < len(self.lights):
            self.start_next()
            return True
        keep(self.name, studio.take_pictures(self.files, self.lights))
        return self.close()

    def close(self) -> bool:
        """Clean up; returns False."""
        self.studio.close()
        shutil.rmtree(self.folder, ignore_errors=True)
        return False


active: Relighting | None = None
last_message = ""
_latest = ""


def tick() -> float | None:
    """Timer: carry a relighting on."""
    global active, last_message
    going = False
    if active is not None:
        try:
            going = active.look()
        except (ReferenceError, RuntimeError, OSError) as error:  # undone, or the file is gone, under us
            active.message = f"The preview was stopped: {error}"
            active.close()
        if not going:
            last_message, active = active.message, None
    job.redraw()
    return job.TICK if going else None


def keep(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Put a picture into the file, with a thumbnail for the panel."""
    global _latest
    _latest = name
    image = studio.keep_picture(name, pixels)
    step = -(-max(pixels.shape[:2]) // THUMBNAIL)
    small = np.ascontiguousarray(pixels[::step, ::step])
    preview = image.preview_ensure()
    preview.image_size = small.shape[1], small.shape[0]
    preview.image_pixels_float.foreach_set(small.ravel())
    return image


def latest_image() -> bpy.types.Image | None:
    """The newest picture, or one that was saved with the file."""
    names = (_latest, PREVIEW, SHEET)
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
        borrowed, lights, name = self._prepare(context)
        with studio.temporary_folder() as folder, borrowed:
            try:
                keep(name, studio.render_all(borrowed, lights, folder))
            except RuntimeError as error:
                self.report({"ERROR"}, str(error))
                return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        global active, last_message
        if bpy.app.background:
            return self.execute(context)
        active, last_message = Relighting(*self._prepare(context)), ""
        active.start_next()
        bpy.app.timers.register(tick, first_interval=job.TICK)
        return {"FINISHED"}

    def _prepare(self, context: bpy.types.Context) -> tuple[studio.Studio, list[Path], str]:
        settings = properties.settings_of(context.scene)
        size = TILE_SIZE if self.every else STILL_SIZE
        look = studio.Look(settings.rotation, settings.strength, settings.samples, size)
        one = hdris.file_of(settings.hdri, settings.hdri_file)
        lights = studio.default_lights() if self.every else [one]
        return studio.Studio(context, look), lights, SHEET if self.every else PREVIEW


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
    """Forget a relighting that runs."""
    global active
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    if active is not None:
        active.close()
        active = None


@bpy.app.handlers.persistent
def _file_closes(*_: object) -> None:
    stop()


def register() -> None:
    """Forget a relighting when its file is closed."""
    bpy.app.handlers.load_pre.append(_file_closes)


def unregister() -> None:
    """Undo `register`."""
    stop()
    bpy.app.handlers.load_pre.remove(_file_closes)


CLASSES = (DANTEW_OT_relight, DANTEW_OT_open_image)
