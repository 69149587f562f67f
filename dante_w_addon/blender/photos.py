"""The photos: which cameras have one, their sizes, and how they get into a scene folder."""

from __future__ import annotations

import os
import shutil
import struct
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..contract.errors import BadInput
from .paths import file_name
from .pixel_files import write_exr, write_png

_SUFFIX = {"PNG": ".png", "JPEG": ".jpg", "OPEN_EXR": ".exr", "TIFF": ".tif", "BMP": ".bmp", "HDR": ".hdr"}


@dataclass(frozen=True)
class Photo:
    """A camera object and the still image behind it."""

    camera: bpy.types.Object
    image: bpy.types.Image


def photos_in(scene: bpy.types.Scene) -> list[Photo]:
    """Every camera with a background image. The image's eye icon leaves a photo out."""
    result = []
    for obj in scene.objects:
        if obj.type != "CAMERA":
            continue
        for background in obj.data.background_images:
            if background.source == "IMAGE" and background.image and background.show_background_image:
                result.append(Photo(obj, background.image))
                break
    return result


def path_of(image: bpy.types.Image) -> Path | None:
    """The image's file, or None where its pixels live in the .blend alone."""
    if image.source != "FILE" or image.packed_file or image.is_dirty or not image.filepath:
        return None
    return Path(os.path.normpath(bpy.path.abspath(image.filepath, library=image.library)))


def problem(photo: Photo) -> str | None:
    """Why a photo cannot be used, as one sentence, or None. Cheap: no image is loaded."""
    camera, image = photo.camera, photo.image
    if camera.data.type != "PERSP":
        return f"{camera.name} is not a perspective camera; change its type or hide its photo."
    if image.source not in ("FILE", "GENERATED"):
        return f"{image.name} is a {image.source.lower()}; use a still image."
    path = path_of(image)
    if path is not None and not path.is_file():
        return f"{image.name} is missing on disk; find it with File > External Data."
    return None


def size_of(image: bpy.types.Image) -> tuple[int, int]:
    """Width and height in pixels; from the file's header where possible, as thousands may be asked.

    Raises:
        BadInput: the image cannot be read.
    """
    path = path_of(image)
    size = header_size(path) if path is not None else None
    if size is None:
        had_pixels = image.has_data
        size = tuple(image.size)
        if not had_pixels and not image.is_dirty and image.source == "FILE":
            image.buffers_free()
    if min(size) < 1:
        raise BadInput(f"{path or image.name}: not a readable image; replace or hide it.")
    return size


def header_size(path: Path) -> tuple[int, int] | None:
    """Width and height of a PNG or JPEG from its first bytes; None for anything else."""
    try:
        with open(path, "rb") as file:
            start = file.read(26)
            if start.startswith(b"\x89PNG\r\n\x1a\n") and len(start) == 26:
                return struct.unpack(">II", start[16:24])
            if not start.startswith(b"\xff\xd8"):
                return None
            file.seek(2)
            while True:
                mark, kind, length = struct.unpack(">BBH", file.read(4))
                if mark != 0xFF or length < 2:
                    return None
                if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):  # a start-of-frame segment
                    height, width = struct.unpack(">xHH", file.read(5))
                    return width, height
                file.seek(length - 2, os.SEEK_CUR)
    except (OSError, struct.error):
        return None


class Folder:
    """The `images` folder of a scene folder that is written: each photo once, no two under one name."""

    def __init__(self, folder: Path) -> None:
        """Put photos into `folder`, which need not exist yet."""
        self.folder = folder
        self._names: set[str] = set()  # in lower case
        self._paths: dict[str, Path] = {}  # by file, or by name of the image

    def place(self, image: bpy.types.Image) -> Path:
        """Put `image` into the folder, hard-linked where the disk allows; returns its path there.

        Raises:
            BadInput: it cannot be read or written.
        """
        source = path_of(image)
        key = str(source or image.name_full)
        if key not in self._paths:
            target = self._free_name(image, source)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                _put(image, source, target)
            except (OSError, RuntimeError) as error:
                raise BadInput(f"{key} cannot be put into {target.parent}: {error}") from error
            self._paths[key] = target
        return self._paths[key]

    def _free_name(self, image: bpy.types.Image, source: Path | None) -> Path:
        # Priors are found by the photo's name, so a name that is taken moves into a folder, named after
        # the one the photo came from.
        if source is not None:
            name, parent = source.name, file_name(source.parent.name)
        else:
            stem = Path(file_name(bpy.path.basename(image.filepath) or image.name))
            packed_suffix = (
                _SUFFIX.get(image.file_format) if image.packed_file and not image.is_dirty else None
            )
            suffix = packed_suffix or (".exr" if image.is_float else ".png")
            name, parent = (stem.name if stem.suffix.lower() == suffix else stem.name + suffix), "packed"
        choices = [name, f"{parent}/{name}", *(f"{parent}_{i}/{name}" for i in range(2, 10_000))]
        choice = next(choice for choice in choices if choice.lower() not in self._names)
        self._names.add(choice.lower())
        return self.folder / choice


def _put(image: bpy.types.Image, source: Path | None, target: Path) -> None:
    if source is not None:
        try:
            os.link(source, target)
        except OSError:  # another disk, or one without hard links
            shutil.copyfile(source, target)
    elif image.packed_file and not image.is_dirty:
        target.write_bytes(image.packed_file.data)
    else:
        _save_pixels(image, target)


def _save_pixels(image: bpy.types.Image, target: Path) -> None:
    """Write the pixels by hand: saving `image` itself would change its path and source."""
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[::-1]  # Blender's rows come from the bottom
    rgba = np.ones((height, width, 4), np.float32)
    if image.channels < 3:
        rgba[..., :3] = pixels[..., :1]  # grey
    else:
        rgba[..., : image.channels] = pixels
    (write_exr if image.is_float else write_png)(target, rgba)
