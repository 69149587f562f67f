"""Small things done with arrays in several rooms."""

from __future__ import annotations

import numpy as np


def sums(values: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32: the rows (M, 3) added up by index (M,)."""
    return np.stack([np.bincount(index, channel, count) for channel in values.T], axis=1).astype(np.float32)
