"""Compiled code is cached, and cached code is never stale."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from dante_w.core import jit

CALLEE = "from dante_w.core.jit import njit_fast\n\n@njit_fast\ndef inner(x):\n    return {}\n"
CALLER = (
    "from callee import inner\nfrom dante_w.core.jit import njit_fast\n\n"
    "@njit_fast\ndef outer(x):\n    return inner(x)\n"
)


def test_a_changed_callee_in_another_file_is_compiled_anew(tmp_path: Path) -> None:
    def run(expression: str) -> list[str]:
        """The result, and how often cached code was used."""
        (tmp_path / "callee.py").write_text(CALLEE.format(expression))
        command = "from caller import outer; print(outer(3.0), sum(outer.stats.cache_hits.values()))"
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
        done = subprocess.run(
            [sys.executable, "-c", command], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    (tmp_path / "caller.py").write_text(CALLER)
    assert run("x + 1.0") == ["4.0", "0"]
    assert run("x + 1.0") == ["4.0", "1"]
    assert run("x * 2.0") == ["6.0", "0"]


@pytest.mark.parametrize("index", [SimpleNamespace(), SimpleNamespace(_source_stamp="")])
def test_nothing_is_cached_where_numba_keeps_no_stamp(monkeypatch: pytest.MonkeyPatch, index: Any) -> None:
    """Or stale code might run with a numba to come."""

    def njit(cache: bool = False, **_: Any) -> Any:
        made = SimpleNamespace(
            stats=SimpleNamespace(cache_path="there"), _cache=SimpleNamespace(_cache_file=index)
        )
        return lambda function: made if cache else "uncached"

    monkeypatch.setattr(jit, "numba", SimpleNamespace(njit=njit))
    stamped = hasattr(index, "_source_stamp")
    assert (jit.njit_fast(test_nothing_is_cached_where_numba_keeps_no_stamp) == "uncached") is not stamped
    assert not stamped or index._source_stamp
