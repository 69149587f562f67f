"""Polygons to triangles."""

from __future__ import annotations

import numpy as np


def fan(sizes: np.ndarray) -> np.ndarray:
    """Cut polygons into fans around their first corner.

    Args:
        sizes: int (P,) corners of each polygon; those with fewer than 3 give no triangle.

    Returns:
        int64 (T, 3) indices into the polygons' corners laid end to end, in the polygons' order.

    >>> fan(np.array([4, 3])).tolist()
    [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    """
    sizes = np.asarray(sizes, np.int64)
    starts = np.cumsum(sizes) - sizes
    triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(starts, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)
