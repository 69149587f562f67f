"""The result folder: everything is staged inside it and put into place at the end, the report last.

A folder without a report is not a whole result. A process may be killed at any moment: before the staging folder gets
its second name the former result stands untouched, from then on the new one does, and whoever comes next, another run or
the process that started this one, finishes what was begun.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from pathlib import Path

from dante_w.errors import BadInput

REPORT = "report.json"
#: Folder in a result folder, see `checkpoints`.
CHECKPOINTS = ".resume"
#: The staging folder while it is filled, once it holds a whole result, and while it is removed.
_STAGING, _WHOLE, _DOOMED = ".partial", ".whole", ".doomed"
_SCRATCH = "dante-w-"


def stage(out: Path) -> Path:
    """Make `out` and an empty staging folder in it; returns that. What a killed process left is put right first.

    Raises:
        BadInput: `out` cannot be written to.
    """
    staging = out / _STAGING
    try:
        _settle(out)
        staging.mkdir(parents=True)
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(f"{out}: cannot write here ({error.strerror}); choose another --out.") from error
    return staging


def scratch() -> Path:
    """A new folder for a run that leaves nothing behind; those of processes that were killed are removed.

    Raises:
        BadInput: no temporary folder can be written to.
    """
    import psutil

    try:
        for old in Path(tempfile.gettempdir()).glob(f"{_SCRATCH}*-*"):
            owner = old.name.removeprefix(_SCRATCH).partition("-")[0]
            if owner.isdecimal() and not psutil.pid_exists(int(owner)):
                shutil.rmtree(old, ignore_errors=True)
        return Path(tempfile.mkdtemp(prefix=f"{_SCRATCH}{os.getpid()}-"))
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(
            f"{error.filename}: no temporary folder can be written ({error.strerror}); set TMPDIR to one that can."
        ) from error


def discard(process: int) -> None:
    """Remove the scratch folders of a process; never raises."""
    with contextlib.suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_SCRATCH}{process}-*"):
            shutil.rmtree(folder, ignore_errors=True)


def publish(out: Path) -> None:
    """Rename what was staged into place and remove the rest.

    Raises:
        BadInput: a folder is in a file's place, or a file cannot be replaced.
    """
    staging = out / _STAGING
    for path in list(staging.iterdir()):
        if path.is_dir():
            shutil.rmtree(path)  # the ray cache, where that went to disk
        elif (out / path.name).is_dir():
            raise BadInput(f"{out / path.name}: is a folder, where a file belongs; rename it.")
    os.rename(staging, out / _WHOLE)  # from here on the new result stands
    try:
        _put_in_place(out)
        shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    except OSError as error:
        raise BadInput(
            f"{error.filename}: cannot be replaced ({error.strerror}); close what uses it and run again."
        ) from error


def abandon(out: Path) -> None:
    """Remove the staging folder, and `out` if that leaves it empty; never raises."""
    with contextlib.suppress(OSError):
        _settle(out)
    with contextlib.suppress(OSError):
        out.rmdir()


def is_full(error: BaseException) -> bool:
    """Whether an error says that the disk is full, or that a file may not grow further."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _settle(out: Path) -> None:
    """Finish or undo what was begun in `out`."""
    if (out / _WHOLE).is_dir():
        _put_in_place(out)
    with contextlib.suppress(OSError):  # a thread that still writes there finds no folder any more
        os.rename(out / _STAGING, out / _DOOMED)
    for name in (_DOOMED, _STAGING):
        shutil.rmtree(out / name, ignore_errors=True)


def _put_in_place(out: Path) -> None:
    whole = out / _WHOLE
    names = sorted(path.name for path in whole.iterdir())
    if REPORT in names:  # else it is in place already, and so is all else
        (out / REPORT).unlink(missing_ok=True)  # from here to the last rename the folder is not whole
    for name in sorted(names, key=lambda name: name == REPORT):
        os.replace(whole / name, out / name)
    whole.rmdir()
