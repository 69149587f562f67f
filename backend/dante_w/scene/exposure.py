"""Exposures that cameras note in their files (EXIF)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dante_w.contract.scene_folder import Frame


def log_exposure(spec: Any) -> float | None:
    """Log of exposure time x sensitivity / f-number^2 (seconds, ISO) from OpenImageIO's `ImageSpec` of a photo; None
    unless it has all three."""
    numbers = [
        spec.get_float_attribute("ExposureTime"),
        spec.get_float_attribute("FNumber"),
        spec.get_float_attribute("Exif:PhotographicSensitivity"),
    ]
    if not all(np.isfinite(number) and number > 0.0 for number in numbers):
        return None
    seconds, f_number, sensitivity = numbers
    return float(np.log(seconds * sensitivity) - 2.0 * np.log(f_number))


def relative_log_exposures(frames: Sequence[Frame]) -> np.ndarray | None:
    """(K,) float64 log exposures of photos with mean 0; None unless every photo has one."""
    values = [frame.log_exposure for frame in frames]
    if any(value is None for value in values):
        return None
    logs = np.array(values, np.float64)
    return logs - logs.mean()
