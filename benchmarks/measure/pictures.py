"""Read, label, arrange and write pictures. Pictures are (H, W, 3) float32 sRGB in [0, 1], top row first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813

PAPER = np.float32(0.965)
INK = (0.13, 0.13, 0.15)


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The colours of a picture, and its alpha (H, W), 1 where it has none."""
    config = oiio.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1  # colours as they stand in the file, not times alpha
    buffer = oiio.ImageBuf(str(path), 0, 0, config)
    pixels = buffer.get_pixels(oiio.FLOAT)
    if buffer.has_error:
        raise OSError(f"{path}: {buffer.geterror()}")
    if pixels.shape[2] < 3:
        pixels = np.repeat(pixels[..., :1], 3, axis=2)
    alpha = pixels[..., 3] if pixels.shape[2] == 4 else np.ones(pixels.shape[:2], np.float32)
    return pixels[..., :3], alpha


def read_on_paper(path: Path) -> np.ndarray:
    """A picture with what is transparent in it shown as paper."""
    colour, alpha = read(path)
    return colour * alpha[..., None] + PAPER * (1.0 - alpha[..., None])


def write(path: Path, picture: np.ndarray) -> None:
    """Write an 8-bit picture; whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = picture.shape
    buffer = oiio.ImageBuf(oiio.ImageSpec(width, height, channels, oiio.UINT8))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(picture, np.float32))
    partial = path.with_name(path.stem + ".partial" + path.suffix)
    buffer.specmod()["png:compressionLevel"] = 9
    if not buffer.write(str(partial)):
        raise OSError(f"{path}: {buffer.geterror()}")
    partial.replace(path)


def caption(picture: np.ndarray, title: str, note: str = "") -> np.ndarray:
    """`picture` with a line of text below it, and a smaller one below that."""
    height, width, _ = picture.shape
    strip = np.full((66, width, 3), PAPER, np.float32)
    buffer = oiio.ImageBuf(np.concatenate([picture, strip]).astype(np.float32))
    for text, size, y in ((title, 19, height + 31), (note, 14, height + 53)):
        if text:
            oiio.ImageBufAlgo.render_text(buffer, width // 2, y, text, size, "DroidSans", INK, "center")
    return buffer.get_pixels(oiio.FLOAT)


def trim(pictures: Sequence[np.ndarray], margin: int = 8) -> list[np.ndarray]:
    """The same rows of all pictures: those where at least one shows more than paper, and a margin."""
    shown = np.any([(np.abs(picture - PAPER) > 0.02).any(axis=(1, 2)) for picture in pictures], axis=0)
    rows = np.flatnonzero(shown)
    keep = slice(max(rows[0] - margin, 0), rows[-1] + 1 + margin)
    return [picture[keep] for picture in pictures]


def grid(rows: Sequence[Sequence[np.ndarray]], gap: int = 12) -> np.ndarray:
    """Equally large pictures in rows, with paper between them and around."""
    height, width, _ = rows[0][0].shape
    down = len(rows) * (height + gap) + gap
    across = max(map(len, rows)) * (width + gap) + gap
    sheet = np.full((down, across, 3), PAPER, np.float32)
    for y, row in enumerate(rows):
        for x, picture in enumerate(row):
            top, left = gap + y * (height + gap), gap + x * (width + gap)
            sheet[top : top + height, left : left + width] = picture
    return sheet
