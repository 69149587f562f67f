"""The result folder: everything is staged inside it and put into place at the end, the report last.

A folder without a report is not a whole result. A process may be killed at any moment: before the staging folder gets
its second name the former result stands untouched, from then on the new one does, and whoever comes next, another run or
the process that started this one, finishes what was begun. The staging folder's name says who fills it: what a living process
has begun, nobody else touches.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path

from dante_w.contract.errors import BadInput

REPORT = "report.json"
#: Folder in a result folder, see `checkpoints`.
CHECKPOINTS = ".resume"
#: The staging folder while it is filled, once it holds a whole result, and while it is removed. Its owner follows in the name.
_STAGING, _WHOLE, _DOOMED = ".partial", ".whole", ".doomed"
#: The owner: the number of a process, and when it began in seconds; the system gives the numbers of dead ones out again.
_OWNER = re.compile(r"-(\d+)-(\d+)|")
#: A process is told that began so near to that; the system's clock may be set meanwhile.
_SAME_START = 5.0
_SCRATCH = "dante-w-"


def stage(out: Path) -> Path:
    """Make `out` and an empty staging folder in it; returns that. What a killed process left is put right first.

    Raises:
        BadInput: `out` cannot be written to, or another run is at work in it.
    """
    staging = out / (_STAGING + _own())
    try:
        _settle(out)
        _refuse_beside_another(out)
        staging.mkdir(parents=True)
        _refuse_beside_another(out)  # of two that come here in the same instant none goes on
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
    staging, whole = out / (_STAGING + _own()), out / (_WHOLE + _own())
    for path in list(staging.iterdir()):
        if path.is_dir():
            shutil.rmtree(path)  # the ray cache, where that went to disk
        elif (out / path.name).is_dir():
            raise BadInput(f"{out / path.name}: is a folder, where a file belongs; rename it.")
    os.rename(staging, whole)  # from here on the new result stands
    try:
        _put_in_place(whole, out)
        shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    except OSError as error:
        raise BadInput(
            f"{error.filename}: cannot be replaced ({error.strerror}); close what uses it and run again."
        ) from error


def abandon(out: Path) -> None:
    """Remove the staging folder, and `out` if that leaves it empty, but nothing of another run at work; never raises."""
    with contextlib.suppress(OSError):
        _settle(out)
    with contextlib.suppress(OSError):
        out.rmdir()


def is_full(error: BaseException) -> bool:
    """Whether an error says that the disk is full, or that a file may not grow further."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _settle(out: Path) -> None:
    """Finish or undo what was begun in `out`, by this process or by one that is dead."""
    for whole in _begun(out, _WHOLE):
        _put_in_place(whole, out)
    for staging in _begun(out, _STAGING):
        with contextlib.suppress(OSError):  # a thread that still writes there finds no folder any more
            os.rename(staging, out / staging.name.replace(_STAGING, _DOOMED))
    for left in (*_begun(out, _DOOMED), *_begun(out, _STAGING)):
        shutil.rmtree(left, ignore_errors=True)


def _refuse_beside_another(out: Path) -> None:
    for kind in (_STAGING, _WHOLE):
        for folder in _begun(out, kind, by_others=True):
            raise BadInput(
                f"{out}: another run (process {folder.name.split('-')[1]}) is at work here; "
                "wait for it or choose another --out."
            )


def _begun(out: Path, kind: str, by_others: bool = False) -> list[Path]:
    """The folders of a kind in `out` that living other processes own, or the rest."""
    found = []
    for path in sorted(out.glob(f"{kind}*")):
        owner = _OWNER.fullmatch(path.name.removeprefix(kind))
        if owner and by_others == (owner[1] is not None and _is_another(int(owner[1]), int(owner[2]))):
            found.append(path)
    return found


@cache
def _own() -> str:
    """What this process puts behind the names of its folders."""
    import psutil

    return f"-{os.getpid()}-{int(psutil.Process().create_time())}"


def _is_another(process: int, began: int) -> bool:
    """Whether a process is not this one and still the one that began then."""
    import psutil

    try:
        found = psutil.Process(process)
        same = abs(found.create_time() - began) < _SAME_START
        return process != os.getpid() and same and found.status() != psutil.STATUS_ZOMBIE
    except (psutil.Error, OverflowError):
        return False


def _put_in_place(whole: Path, out: Path) -> None:
    names = sorted(path.name for path in whole.iterdir())
    if REPORT in names:  # else it is in place already, and so is all else
        (out / REPORT).unlink(missing_ok=True)  # from here to the last rename the folder is not whole
    for name in sorted(names, key=lambda name: name == REPORT):
        os.replace(whole / name, out / name)
    whole.rmdir()
