"""Which photos take no part in a fit, so that it can be measured on them."""

from __future__ import annotations

import numpy as np

#: One photo in this many is held out ...
ONE_IN = 8
#: ... from this many photos up.
FEWEST = 5


def choose_held_out(photos: int) -> np.ndarray:
    """Indices of the held-out photos, evenly spread; at least one from five photos up, none below."""
    if photos < FEWEST:
        return np.zeros(0, np.int64)
    count = max(photos // ONE_IN, 1)
    return ((np.arange(count) + 0.5) * photos / count).astype(np.int64)
