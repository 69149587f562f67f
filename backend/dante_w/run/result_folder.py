"""The result folder: everything is staged inside it and put into place at the end, the report last.

A folder without a report is not a whole result. A process may be killed at any moment: before the staging folder gets
its second name the former result stands untouched, from then on the new one does, and whoever comes next, another run or
the process that started this one, finishes the move. The staging folder's name and its marker say who fills it: nobody else
touches the folder of a living process. Nothing without such a marker is touched, whatever its name, see `own_folders`; but
links by these names are removed, themselves alone. A result is exactly its files: those of the former one that
the new one does not have are removed. The result folder itself may be a link, for the user named it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from dante_w.contract.errors import BadInput
from dante_w.contract.report import REPORT
from dante_w.run.own_folders import is_file, is_folder, is_link, make, owner, remove, remove_own
from dante_w.run.result_files import names_in, names_written, refuse_foreign

#: Folder in a result folder, see `checkpoints`.
CHECKPOINTS = ".resume"
#: The staging folder while it is filled, once it holds a whole result, and while it is removed. Its owner follows in the name.
_STAGING, _WHOLE, _DOOMED = ".partial", ".whole", ".doomed"
#: Their names; the owner is the number of a process, and when it began in seconds: the system gives the numbers of dead ones
#: out again. Without an owner, only links are of interest.
_NAME = re.compile(r"(\.partial|\.whole|\.doomed)(?:-((\d+)-(\d+)))?")
#: Seconds that the start of a process may seem to be off; the system's clock may be set meanwhile.
_SAME_START = 5.0
#: The former result's report in a whole one, while that is put into place.
_FORMER = "former.json"


def stage(out: Path, names: Iterable[str]) -> Path:
    """Make `out` and a staging folder in it for files of these `names`; returns that. What a killed process left is put right
    first.

    Raises:
        BadInput: `out` cannot be written to, another run is at work in it, or one of the names is taken by something
            that no earlier run wrote.
    """
    staging = out / f"{_STAGING}-{_own_token()}"
    try:
        _settle(out)
        _refuse_beside_another(out)
        refuse_foreign(out, names, names_written(out / REPORT))
        make(staging, _own_token())
        _refuse_beside_another(out)  # of two that come here in the same instant none goes on
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(f"{out}: cannot write here ({error.strerror}); choose another --out.") from error
    return staging


def publish(out: Path) -> None:
    """Rename what was staged into place and remove the rest.

    Raises:
        BadInput: something that no earlier run wrote is in a file's place, or a file cannot be replaced.
    """
    staging, whole = (out / f"{kind}-{_own_token()}" for kind in (_STAGING, _WHOLE))
    for path in list(staging.iterdir()):
        if is_folder(path):
            remove(path)  # the ray cache, where that went to disk
    refuse_foreign(out, names_in(staging), names_written(out / REPORT))
    try:
        os.rename(staging, whole)  # from here on the new result stands
        _put_in_place(whole, out)
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(
            f"{error.filename}: cannot be replaced ({error.strerror}); close what uses it and run again."
        ) from error
    remove_checkpoints(out)


def abandon(out: Path) -> None:
    """Remove the staging folder, and `out` if that leaves it empty, but nothing of another run at work; never raises."""
    with contextlib.suppress(OSError, BadInput):
        _settle(out)
    with contextlib.suppress(OSError):
        out.rmdir()


def remove_checkpoints(out: Path) -> None:
    """Remove the checkpoints in `out`, or a link in their place; a folder that no run made stays."""
    folder = out / CHECKPOINTS
    if is_link(folder):
        remove(folder)
    else:
        remove_own(folder, owner(folder) or "")


def is_full(error: BaseException) -> bool:
    """Whether an error says that the disk is full, or that a file may not grow further."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _settle(out: Path) -> None:
    """Finish or undo the moves of this process and of dead ones in `out`.

    Raises:
        BadInput: a result cannot be finished, see `publish`.
    """
    for path in _reserved(out):
        if is_link(path):
            remove(path)
    for whole, token in _folders(out, _WHOLE):
        if owner(whole) == token:
            _put_in_place(whole, out)
    for staging, token in _folders(out, _STAGING):
        if owner(staging) == token:
            with contextlib.suppress(OSError):  # a thread that still writes there finds no folder any more
                os.rename(staging, out / f"{_DOOMED}-{token}")
    for kind in (_DOOMED, _STAGING, _WHOLE):
        for folder, token in _folders(out, kind):
            remove_own(folder, token)


def _refuse_beside_another(out: Path) -> None:
    for kind in (_STAGING, _WHOLE):
        for _, token in _folders(out, kind, others=True):
            raise BadInput(
                f"{out}: another run (process {token.partition('-')[0]}) is at work here; "
                "wait for it or choose another --out."
            )


def _reserved(out: Path) -> list[Path]:
    """What has a name that a staging folder can have, in `out`."""
    try:
        return sorted(path for path in out.iterdir() if _NAME.fullmatch(path.name))
    except FileNotFoundError:
        return []


def _folders(out: Path, kind: str, others: bool = False) -> Iterator[tuple[Path, str]]:
    """The folders of a kind in `out` that other living processes own by their name, or the rest; each with its owner's token."""
    for path in _reserved(out):
        name = _NAME.fullmatch(path.name)
        if not name or name[1] != kind or not name[2] or not is_folder(path):
            continue
        if _is_another(int(name[3]), int(name[4])) == others:
            yield path, name[2]


@cache
def _own_token() -> str:
    """What this process puts behind the names of its folders."""
    import psutil

    return f"{os.getpid()}-{int(psutil.Process().create_time())}"


def _is_another(process: int, start: int) -> bool:
    """Whether a process is not this one and still the one that began then."""
    import psutil

    try:
        other = psutil.Process(process)
        same = abs(other.create_time() - start) < _SAME_START
        return process != os.getpid() and same and other.status() != psutil.STATUS_ZOMBIE
    except (psutil.Error, OverflowError):
        return False


def _put_in_place(whole: Path, out: Path) -> None:
    """Move the files of a whole result into `out`, and remove those of the former one that it does not have."""
    names = names_in(whole)
    if REPORT in names:  # else it is in place already, and so is all else
        former = names_written(out / REPORT) or names_written(whole / _FORMER)
        refuse_foreign(out, names, former)
        if is_file(out / REPORT):
            os.replace(out / REPORT, whole / _FORMER)  # from here to the last rename the folder is not whole
        for name in former:
            if name not in names_written(whole / REPORT) and is_file(out / name):
                os.unlink(out / name)
        for name in names:
            os.replace(whole / name, out / name)
    remove(whole)
