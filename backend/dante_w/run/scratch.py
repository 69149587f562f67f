"""Temporary folders of runs that leave nothing behind."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from dante_w.contract.errors import BadInput
from dante_w.run.own_folders import mark, remove_own
from dante_w.run.result_folder import is_full

_PREFIX = "dante-w-"


def scratch() -> Path:
    """A new folder for a run that leaves nothing behind; those of processes that were killed are removed.

    Raises:
        BadInput: no temporary folder can be written to.
    """
    import psutil

    try:
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
            process = folder.name.removeprefix(_PREFIX).partition("-")[0]
            if process.isdecimal() and not psutil.pid_exists(int(process)):
                remove_own(folder, process)
        folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        mark(folder, str(os.getpid()))
        return folder
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(
            f"{error.filename}: no temporary folder can be written ({error.strerror}); set TMPDIR to one that can."
        ) from error


def discard(process: int) -> None:
    """Remove the scratch folders of a process; never raises."""
    with contextlib.suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}{process}-*"):
            remove_own(folder, str(process))
