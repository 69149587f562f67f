"""Photos, masks and textures in and out, through OpenImageIO.

Arrays are (height, width[, channels]) with row 0 at the top. Integer files (PNG, JPEG, 8/16-bit TIFF, WebP)
hold sRGB-encoded values; float files (EXR, HDR, float TIFF) hold linear Rec.709. The EXIF orientation is
ignored on purpose: poses refer to the pixels as stored, in COLMAP as well.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import psutil

from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.core.color import linear_from_srgb_array, srgb_from_linear_array
from dante_w.scene.exposure import log_exposure

#: OpenImageIO's names of the formats that are read.
FORMATS = ("png", "jpeg", "tiff", "openexr", "hdr", "webp")
#: Width x height x channels, a 16384 x 16384 RGBA texture; more is a broken header.
MAX_SAMPLES = 2**30
#: Of memory while a picture is decoded, at most: measured with EXR.
BYTES_PER_SAMPLE = 16
#: Scanlines handed to a writer at once.
_BAND = 256


@dataclass(frozen=True)
class ForegroundSettings:
    """Which pixels of a photo are explained: those that show the object and nothing beside it."""

    #: Alpha above this: the edge of a cut-out mixes in its background.
    alpha: float = 0.95
    #: Value of the mask's first channel, as stored in the file, above this: masks are black and white.
    mask: float = 0.5


FOREGROUND = ForegroundSettings()


@dataclass(frozen=True)
class Photo:
    """One photo, row 0 at the top.

    Attributes:
        srgb: (H, W, 3) float32, sRGB-encoded, above 1 where a float file is brighter than white.
        foreground: (H, W) bool, the pixels to explain.
        linear: whether its file holds floats, whose radiance has any scale.
    """

    srgb: np.ndarray
    foreground: np.ndarray
    linear: bool = False


@dataclass(frozen=True)
class Header:
    """The header of an image's file: size in pixels, and `exposure.log_exposure`."""

    width: int
    height: int
    log_exposure: float | None


def read_header(path: Path) -> Header:
    """The header of an image; its pixels are not read.

    Raises:
        BadInput: the file is missing or not an image.
    """
    source = _open(path)
    spec = source.spec()
    source.close()
    return Header(spec.full_width, spec.full_height, log_exposure(spec))


def read_photo(path: Path, mask: Path | None = None, settings: ForegroundSettings = FOREGROUND) -> Photo:
    """Read a photo, its alpha and its optional mask file.

    Foreground is what lies inside the alpha (photos without: everything), inside the mask's first channel, and is finite;
    pixels that are not finite are set to 0.

    Raises:
        BadInput: a file is missing, damaged or too large, or the mask has another size than the photo.
        OutOfRoom: the photo does not fit in memory.
    """
    colour, alpha, linear = _read(path)
    srgb = srgb_from_linear_array(colour) if linear else colour
    finite = np.isfinite(srgb).all(axis=2)
    if not finite.all():
        srgb[~finite] = 0.0
    foreground = finite if alpha is None else finite & (alpha > settings.alpha)
    if mask is not None:
        shown = _read(mask)[0][:, :, 0]
        if shown.shape != foreground.shape:
            raise BadInput(
                f"{mask}: the mask is {shown.shape[1]} x {shown.shape[0]} pixels but its photo is "
                f"{foreground.shape[1]} x {foreground.shape[0]}; export it at the photo's size."
            )
        foreground = foreground & (shown > settings.mask)
    return Photo(srgb, foreground, linear)


def read_prior(path: Path) -> np.ndarray:
    """Read a picture of albedo: float32 (H, W, 4), sRGB-encoded albedo and each pixel's weight in [0, 1]: its alpha, 1
    without any. NaN where the weight is 0 or a colour is not finite.

    Raises:
        BadInput: the file is missing, damaged or too large.
        OutOfRoom: the picture does not fit in memory.
    """
    colour, alpha, linear = _read(path)
    srgb = srgb_from_linear_array(colour) if linear else colour
    weight = np.ones(srgb.shape[:2], np.float32) if alpha is None else np.clip(alpha, 0.0, 1.0)
    prior = np.concatenate([srgb, weight[..., None]], axis=2, dtype=np.float32)
    prior[~(np.isfinite(prior).all(axis=2) & (weight > 0.0))] = np.nan
    return prior


def read_texture(path: Path) -> np.ndarray:
    """Any texture as float32 linear Rec.709 (H, W, 3); integer files are decoded from sRGB.

    Raises:
        BadInput: the file is missing, damaged or too large.
        OutOfRoom: the texture does not fit in memory.
    """
    colour, _, linear = _read(path)
    return colour if linear else linear_from_srgb_array(colour)


def write_png(path: Path, srgb: np.ndarray) -> None:
    """Write sRGB-encoded uint8 or uint16 (H, W, 3) as PNG; (H, W) is written as grey.

    Raises:
        OutOfRoom: the disk is full.
        BadInput: the file cannot be created.
    """
    if srgb.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"a PNG holds uint8 or uint16, not {srgb.dtype}")
    _write(path, srgb, {"oiio:ColorSpace": "srgb_rec709_scene"})


def write_exr(path: Path, linear: np.ndarray) -> None:
    """Write linear Rec.709 float16 or float32 (H, W, 3) as a losslessly compressed OpenEXR file.

    Raises:
        OutOfRoom: the disk is full.
        BadInput: the file cannot be created.
    """
    if linear.dtype not in (np.float16, np.float32):
        raise TypeError(f"an EXR holds float16 or float32, not {linear.dtype}")
    # OpenImageIO would note the time, and the same texture would never have the same bytes
    _write(path, linear, {"oiio:ColorSpace": "lin_rec709_scene", "compression": "zip", "DateTime": ""})


def _open(path: Path) -> Any:
    """An open reader of a flat image of sane size."""
    if not Path(path).is_file():
        raise BadInput(f"{path}: there is no such image; correct its path or copy it there.")
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        raise BadInput(f"{path}: cannot be read as an image ({_reason(oiio)}); save it again.")
    spec = source.spec()
    if source.format_name() not in FORMATS:
        raise BadInput(f"{path}: images of this kind are not read; save it as PNG, JPEG, TIFF or EXR.")
    if spec.deep or spec.full_depth > 1 or spec.depth > 1:
        raise BadInput(f"{path}: a deep or volume image is not a photo; save it as a flat image.")
    # the picture is the display window; the data window may be cropped or reach beyond it
    for width, height in ((spec.width, spec.height), (spec.full_width, spec.full_height)):
        if width < 1 or height < 1 or width * height * max(spec.nchannels, 3) > MAX_SAMPLES:
            raise BadInput(
                f"{path}: a size of {width} x {height} with {spec.nchannels} channels is too large or empty; "
                "save it smaller."
            )
    return source


def _read(path: Path) -> tuple[np.ndarray, np.ndarray | None, bool]:
    """Colour float32 (H, W, 3) as stored, straight; alpha (H, W) or None; whether the colour is linear."""
    source = _open(path)
    spec = source.spec()
    size = BYTES_PER_SAMPLE * spec.width * spec.height * spec.nchannels
    if size > psutil.virtual_memory().available:  # a file of a few kB may say so
        source.close()
        raise OutOfRoom(
            f"{path}: reading {spec.width} x {spec.height} pixels takes {size / 1e9:.1f} GB of memory, more than is free; "
            "use a smaller image."
        )
    try:
        pixels = source.read_image(oiio.FLOAT)
    except MemoryError as error:
        raise OutOfRoom(f"{path}: does not fit in memory; use a smaller image.") from error
    damaged = pixels is None or source.has_error  # a cut JPEG yields pixels and an error
    reason = _reason(source)
    source.close()
    if damaged:
        raise BadInput(f"{path}: is damaged ({reason}); copy or save it again.")
    pixels = _display_window(pixels.reshape(spec.height, spec.width, spec.nchannels), spec)
    index = spec.alpha_channel
    alpha = pixels[:, :, index] if 0 <= index < spec.nchannels else None
    try:
        names = list(spec.channelnames)
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: is damaged (its channels have no names); copy or save it again.") from error
    if {"R", "G", "B"} <= set(names):
        chosen = [names.index(name) for name in "RGB"]
    else:
        others = [i for i in range(spec.nchannels) if i != index]
        chosen = others[:3] if len(others) >= 3 else others[:1] * 3
    if not chosen:
        raise BadInput(f"{path}: holds alpha but no colour; save it with its colour channels.")
    colour = pixels if chosen == list(range(spec.nchannels)) else pixels[:, :, chosen]
    if alpha is not None and not spec.getattribute("oiio:UnassociatedAlpha"):
        partial = (alpha > 0.0) & (alpha < 1.0)  # premultiplied
        colour[partial] /= alpha[partial][:, None]
    linear = spec.format.basetype in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)
    return np.ascontiguousarray(colour), alpha, linear


def _display_window(pixels: np.ndarray, spec: Any) -> np.ndarray:
    """Crop or pad (H, W, C) with zeros from the data window to the display window."""
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    if (left, top, spec.width, spec.height) == (0, 0, spec.full_width, spec.full_height):
        return pixels
    whole = np.zeros((spec.full_height, spec.full_width, spec.nchannels), np.float32)
    rows = slice(max(top, 0), max(min(top + spec.height, spec.full_height), 0))
    columns = slice(max(left, 0), max(min(left + spec.width, spec.full_width), 0))
    part = whole[rows, columns]
    if part.size:
        part[...] = pixels[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return whole


def _write(path: Path, pixels: np.ndarray, attributes: dict[str, str]) -> None:
    height, width = pixels.shape[:2]
    kind = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}[pixels.dtype.name]
    spec = oiio.ImageSpec(width, height, pixels.shape[2] if pixels.ndim == 3 else 1, kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    target = oiio.ImageOutput.create(str(path))
    if target is None or not target.open(str(path), spec):
        raise BadInput(
            f"{path}: cannot be written ({_reason(target or oiio)}); choose a folder you may write to."
        )
    complete = True
    for top in range(0, height, _BAND):
        band = np.ascontiguousarray(pixels[top : top + _BAND]).reshape(-1, width, spec.nchannels)
        # the PNG writer returns True on a full disk; writing on after a failure can hang
        complete = target.write_scanlines(top, top + len(band), 0, band) and not target.has_error
        if not complete:
            break
    reason = _reason(target)
    complete = target.close() and complete
    if not (complete and _ends_well(path, height)):
        if not path.is_symlink():
            path.unlink(missing_ok=True)
        raise OutOfRoom(f"{path}: could not be written whole ({reason}); free some disk space.")


def _ends_well(path: Path, height: int) -> bool:
    """Whether the end of a file just written is there: neither writer notices that its last bytes were lost."""
    if not path.is_file():
        return False
    if path.suffix.lower() == ".png":
        with open(path, "rb") as file:
            file.seek(-min(12, path.stat().st_size), os.SEEK_END)
            return file.read()[4:8] == b"IEND"
    source = oiio.ImageInput.open(str(path))
    return source is not None and source.read_scanlines(height - 1, height, 0, 0, 1, oiio.FLOAT) is not None


def _reason(source: Any) -> str:
    """The first line of OpenImageIO's latest error, which may quote a damaged file's bytes."""
    try:
        return source.geterror().strip().split("\n")[0] or "no reason given"
    except UnicodeDecodeError:
        return "no reason given"
