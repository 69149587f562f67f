"""Which photos take no part in a fit, so that it can be measured on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HeldOutSettings:
    """How many photos are held out."""

    #: One photo in this many is held out ...
    one_in: int = 8
    #: ... from this many photos up: a fit to fewer could not spare one.
    fewest: int = 5


HELD_OUT = HeldOutSettings()


def choose_held_out(photos: int, settings: HeldOutSettings = HELD_OUT) -> np.ndarray:
    """int64 indices of the held-out among so many photos, evenly spread; at least one from `fewest` photos up, none below."""
    if photos < settings.fewest:
        return np.zeros(0, np.int64)
    count = max(photos // settings.one_in, 1)
    return ((np.arange(count) + 0.5) * photos / count).astype(np.int64)
