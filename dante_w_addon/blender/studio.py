"""Cycles previews of a scene under an HDRI.

They are rendered in a scene of their own that borrows the user's objects, without the lamps, and is removed
afterwards. So there are no render settings or world to restore, whatever happens.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import blf
import bpy
import imbuf
import numpy as np

from . import hdris

LEFT_OUT = {"LIGHT", "CAMERA", "LIGHT_PROBE", "SPEAKER"}
BORROWED = "dante_w_borrowed"  # custom property of a scene made here
GAP = 4  # pixels between the tiles of a contact sheet


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


class Studio:
    """The borrowed scene. Use as a context manager, or `close` it.

    Example:
        with Studio(bpy.context, Look()) as studio:
            picture = studio.still(hdris.presets()["forest"], Path("forest.png"))
    """

    def __init__(self, context: bpy.types.Context, look: Look) -> None:
        user = context.scene
        self._look = look
        _remove_leftovers()
        self.scene = bpy.data.scenes.new("DANTE-W relight")
        self.scene[BORROWED] = True
        self.world = bpy.data.worlds.new("DANTE-W relight")
        self.scene.world = self.world
        self.scene.camera = user.camera
        self.scene.frame_current = user.frame_current
        for obj in context.view_layer.objects:
            if obj.type not in LEFT_OUT and not obj.hide_render and obj.visible_get():
                self.scene.collection.objects.link(obj)
        self.scene.collection.objects.link(user.camera)
        self._render_settings(user)
        self._mapping, self._environment, self._background = _world_nodes(self.world)

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the borrowed scene and what was made for it."""
        with contextlib.suppress(ReferenceError):
            image = self._environment.image
            bpy.data.scenes.remove(self.scene)
            bpy.data.worlds.remove(self.world)
            if image is not None and image.users == 0:
                bpy.data.images.remove(image)

    def light(self, hdri: Path, target: Path) -> None:
        """Set the HDRI, and where the picture goes."""
        old = self._environment.image
        self._environment.image = bpy.data.images.load(str(hdri), check_existing=False)
        self._environment.image.colorspace_settings.name = "Linear Rec.709"
        if old is not None:
            bpy.data.images.remove(old)
        self._mapping.inputs["Rotation"].default_value[2] = self._look.rotation
        self._background.inputs["Strength"].default_value = self._look.strength
        self.scene.render.filepath = str(target)

    def still(self, hdri: Path, target: Path) -> Path:
        """Render a PNG and wait for it."""
        self.light(hdri, target)
        bpy.ops.render.render(write_still=True, scene=self.scene.name)
        return target

    def _render_settings(self, user: bpy.types.Scene) -> None:
        render, source = self.scene.render, user.render
        render.engine = "CYCLES"
        longer = max(source.resolution_x, source.resolution_y)
        render.resolution_x = max(round(source.resolution_x * self._look.size / longer), 4)
        render.resolution_y = max(round(source.resolution_y * self._look.size / longer), 4)
        render.resolution_percentage = 100
        render.pixel_aspect_x, render.pixel_aspect_y = source.pixel_aspect_x, source.pixel_aspect_y
        render.image_settings.file_format = "PNG"
        render.image_settings.color_mode = "RGB"
        render.use_file_extension = False
        for name in ("view_transform", "look", "exposure", "gamma"):
            setattr(self.scene.view_settings, name, getattr(user.view_settings, name))
        cycles = self.scene.cycles
        cycles.device = user.cycles.device
        cycles.samples = self._look.samples
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = False
        if can_denoise():
            cycles.use_denoising = True
            cycles.denoiser = "OPENIMAGEDENOISE"


def _remove_leftovers() -> None:
    """Undo can bring back a borrowed scene that was removed."""
    for scene in [scene for scene in bpy.data.scenes if BORROWED in scene]:
        bpy.data.scenes.remove(scene)


def _world_nodes(world: bpy.types.World) -> tuple[bpy.types.Node, bpy.types.Node, bpy.types.Node]:
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
    return mapping, environment, background


def contact_sheet(pictures: Sequence[np.ndarray], columns: int = 0) -> np.ndarray:
    """Tile equally large pictures (H, W, C), the first one top left, as rows from the bottom as Blender has them."""
    side = math.ceil(math.sqrt(len(pictures)))
    even = (columns for columns in range(side, 2 * side) if len(pictures) % columns == 0)  # no empty place
    columns = columns or next(even, side)
    rows = math.ceil(len(pictures) / columns)
    height, width, channels = pictures[0].shape
    sheet = np.zeros((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, channels), np.float32)
    sheet[..., 3:] = 1.0
    for index, picture in enumerate(pictures):
        row, column = rows - 1 - index // columns, index % columns
        y, x = row * (height + GAP), column * (width + GAP)
        sheet[y : y + height, x : x + width] = picture
    return sheet


def read_picture(path: Path) -> np.ndarray:
    """Pixels (H, W, 4) of an image file, as stored, rows from the bottom."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(image.size[1], image.size[0], -1)
    finally:
        bpy.data.images.remove(image)


def keep_picture(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Put pixels (H, W, 4) into the packed image datablock `name`, made anew where the size differs."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(name)
    if image is not None and tuple(image.size) != (width, height):
        bpy.data.images.remove(image)
        image = None
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    image.pack()
    return image


def write_label(path: Path, text: str) -> None:
    """Write `text` into the lower left corner of an image file, where this Blender can (4.3 and later)."""
    if not hasattr(blf, "bind_imbuf"):
        return
    picture = imbuf.load(str(path))
    height = max(picture.size[1] // 14, 8)
    with blf.bind_imbuf(0, picture, display_name="sRGB"):
        blf.size(0, height)
        outline = [(x, y, 0.0) for x in (-1, 0, 1) for y in (-1, 0, 1)]  # readable on any background
        for x, y, shade in (*outline, (0, 0, 1.0)):
            blf.color(0, shade, shade, shade, 1.0)
            blf.position(0, height // 2 + x, height // 2 + y, 0)
            blf.draw_buffer(0, text)
    imbuf.write(picture, filepath=str(path))
    picture.free()


def take_pictures(files: Sequence[Path], lights: Sequence[Path]) -> np.ndarray:
    """One rendered file as it is; several as a contact sheet, each with its light's name."""
    if len(files) == 1:
        return read_picture(files[0])
    for file, light in zip(files, lights, strict=True):
        write_label(file, hdris.title(light.stem))
    return contact_sheet([read_picture(file) for file in files])


def render_all(
    studio: Studio, lights: Sequence[Path], folder: Path, step: Callable[[int], None] = lambda index: None
) -> np.ndarray:
    """Render a still per HDRI and tile them; one HDRI gives a plain still. Waits for the renders."""
    files = []
    for index, hdri in enumerate(lights):
        step(index)
        files.append(studio.still(hdri, folder / f"{index}.png"))
    return take_pictures(files, lights)


@contextlib.contextmanager
def temporary_folder():
    """A folder for pictures on their way into Blender."""
    folder = Path(tempfile.mkdtemp(prefix="dante_w_", dir=bpy.app.tempdir))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def default_lights() -> list[Path]:
    """Every HDRI that ships with Blender."""
    return list(hdris.presets().values())
