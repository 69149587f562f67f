"""Write pixels to PNG and EXR files, exactly.

Blender's own saving goes through colour management, whose outcome differs between versions.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 4) values in 0..1, the top row first, as an 8-bit RGBA PNG."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # each row starts with its filter, 0: none
    rows[:, 1:] = np.rint(np.clip(pixels, 0.0, 1.0) * 255.0).reshape(height, -1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6))
        + chunk(b"IEND", b"")
    )


def write_exr(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 4) linear values, the top row first, as an uncompressed 32-bit RGBA EXR."""
    height, width, _ = pixels.shape
    float_channel = struct.pack("<iB3xii", 2, 0, 1, 1)
    channels = b"".join(name + b"\0" + float_channel for name in (b"A", b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    attributes = (
        (b"channels", b"chlist", channels),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
        (b"screenWindowCenter", b"v2f", struct.pack("<ff", 0.0, 0.0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
    )
    header = struct.pack("<ii", 20000630, 2)
    for name, kind, value in attributes:
        header += name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
    header += b"\0"
    line = 8 + 16 * width  # row number, byte count, four channels of floats
    offsets = len(header) + 8 * height + line * np.arange(height, dtype="<u8")
    planes = np.ascontiguousarray(pixels[..., ::-1].transpose(0, 2, 1), "<f4")  # A, B, G, R in each row
    with open(path, "wb") as file:
        file.write(header + offsets.tobytes())
        for row in range(height):
            file.write(struct.pack("<ii", row, 16 * width) + planes[row].tobytes())
