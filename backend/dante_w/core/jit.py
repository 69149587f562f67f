"""numba's `njit` with the compiled code cached where that is possible."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

#: Sums may be reordered and products fused; NaN and infinity keep their meaning.
_FAST: dict[str, Any] = {"error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz", "arcp"}}


def njit(function: Callable[..., Any]) -> Any:
    """Compile on first call; keep the machine code beside the source or else in the user's cache."""
    return _cached(function, parallel=False)


def njit_parallel(function: Callable[..., Any]) -> Any:
    """The same, with `numba.prange` loops spread over threads."""
    return _cached(function, parallel=True)


def njit_parallel_fast(function: Callable[..., Any]) -> Any:
    """The same, with sums reordered and products fused as `njit_fast` may."""
    return _cached(function, parallel=True, **_FAST)


def njit_fast(function: Callable[..., Any]) -> Any:
    """Compile for speed: sums may be reordered and products fused, so loops become SIMD; NaN and infinity keep their
    meaning. The GIL is free while it runs, so several threads may call it at once.

    Such functions may call each other across the files of a folder: cached code is used while none of these changed.
    """
    return _fast(function)


def njit_inlined(function: Callable[..., Any]) -> Any:
    """The same, for helpers of such functions: their code is always put into each caller.

    Otherwise a helper has two compiled bodies, its own and one in the caller's cached code, which may differ in the last bit.
    Which one runs would depend on whether this process compiled them or loaded them from the cache.
    """
    return _fast(function, forceinline=True)


def _fast(function: Callable[..., Any], **options: Any) -> Any:
    options = {"nogil": True, **_FAST, **options}
    compiled = _cached(function, **options)
    return compiled if _stamp(compiled, function) else numba.njit(**options)(function)


def _cached(function: Callable[..., Any], **options: Any) -> Any:
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no place is writable (a locked-down machine): compile in each process
        return numba.njit(**options)(function)


def _stamp(compiled: Any, function: Callable[..., Any]) -> bool:
    """Have cached code used only while no file of the function's folder has changed.

    Cached code of a function contains that of those it calls, but numba compares the time and size of the function's
    own file alone and has no public way to name others. So the stamp that it compares is replaced, which is private:
    `_source_stamp` of numba's index file. Returns False where another version of numba keeps no such stamp; then
    nothing may be cached, as stale code would give wrong results.
    """
    if compiled.stats.cache_path is None:  # nothing is cached
        return True
    index: Any = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if not hasattr(index, "_source_stamp"):
        return False
    index._source_stamp = _digest(Path(function.__code__.co_filename).parent)
    return True


@cache
def _digest(folder: Path) -> str:
    """Of the sources in a folder."""
    sources = sorted(folder.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in sources)).hexdigest()
