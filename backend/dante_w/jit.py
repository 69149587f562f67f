"""numba's `njit` with the compiled code cached where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def njit(function: Callable[..., Any]) -> Any:
    """Compile on first call; keep the machine code beside the source or else in the user's cache.

    With neither place writable (a locked-down machine) numba refuses: then compile in each process.
    """
    try:
        return numba.njit(cache=True)(function)
    except RuntimeError:
        return numba.njit(function)
