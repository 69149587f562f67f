"""numba's `njit` with the compiled code cached where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def njit(function: Callable[..., Any]) -> Any:
    """Compile on first call; keep the machine code beside the source or else in the user's cache."""
    return _cached(function, parallel=False)


def njit_parallel(function: Callable[..., Any]) -> Any:
    """The same, with `numba.prange` loops spread over threads."""
    return _cached(function, parallel=True)


def _cached(function: Callable[..., Any], parallel: bool) -> Any:
    try:
        return numba.njit(cache=True, parallel=parallel)(function)
    except RuntimeError:  # no place is writable (a locked-down machine): compile in each process
        return numba.njit(parallel=parallel)(function)
