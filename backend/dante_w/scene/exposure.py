"""Exposures that cameras note in their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813


def log_exposures(files: Sequence[Path]) -> np.ndarray | None:
    """(K,) log of exposure time x sensitivity / f-number^2 from EXIF, with mean 0; None unless every file tells all
    three."""
    found = [_log_exposure(file) for file in files]
    if any(value is None for value in found):
        return None
    logs = np.array(found, np.float64)
    return logs - logs.mean()


def _log_exposure(file: Path) -> float | None:
    source = oiio.ImageInput.open(str(file))
    if source is None:
        oiio.geterror()  # or it is printed at the end
        return None
    spec = source.spec()
    source.close()
    numbers = [
        spec.get_float_attribute("ExposureTime"),
        spec.get_float_attribute("FNumber"),
        spec.get_float_attribute("Exif:PhotographicSensitivity"),
    ]
    if not all(np.isfinite(number) and number > 0.0 for number in numbers):
        return None
    seconds, stop, sensitivity = numbers
    return float(np.log(seconds * sensitivity) - 2.0 * np.log(stop))
