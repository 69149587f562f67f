"""Folders that a run makes for itself inside folders of the user, and how they are recognised and removed safely.

No name is trusted and no link is followed. A folder is ours only if it is a real directory that holds a marker with its
owner's token. A link is removed itself, never what it points to. Junctions of Windows count as links; that path is untested.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
from pathlib import Path

#: File that says whose a folder is.
MARKER = "owner.txt"
_BEGIN, _END = "Made by DANTE-W, which removes this folder. Owner: ", "\n"
#: More bytes than any marker has.
_LONGEST = 1000
#: How Windows tags a junction.
_JUNCTION = 0xA0000003


def is_link(path: Path) -> bool:
    """Whether a path is a symbolic link or a junction, wherever it leads."""
    status = _stat(path)
    return status is not None and (stat.S_ISLNK(status.st_mode) or _is_junction(status))


def is_folder(path: Path) -> bool:
    """Whether a path is a directory itself, not a link to one."""
    status = _stat(path)
    return status is not None and stat.S_ISDIR(status.st_mode) and not _is_junction(status)


def is_file(path: Path) -> bool:
    """Whether a path is a regular file itself, not a link to one."""
    status = _stat(path)
    return status is not None and stat.S_ISREG(status.st_mode)


def make(folder: Path, token: str) -> None:
    """Make a new folder, and its parents, and mark it with its owner's token.

    Raises:
        OSError: it cannot be made, or something is there already.
    """
    folder.mkdir(parents=True)
    mark(folder, token)


def mark(folder: Path, token: str) -> None:
    """Mark a new folder with its owner's token. Raises OSError as `make`."""
    with open(folder / MARKER, "x", encoding="utf-8") as file:
        file.write(_BEGIN + token + _END)


def owner(folder: Path) -> str | None:
    """The token of the owner of a folder that was made by `make`; None for anything else."""
    if not (is_folder(folder) and is_file(folder / MARKER)):
        return None
    try:
        with open(folder / MARKER, encoding="utf-8") as file:
            text = file.read(_LONGEST)
    except (OSError, ValueError):
        return None
    return text[len(_BEGIN) : -len(_END)] if text.startswith(_BEGIN) and text.endswith(_END) else None


def remove(path: Path) -> None:
    """Remove a folder with all that is in it, a file, or a link itself; what cannot be removed stays."""
    with contextlib.suppress(OSError):
        if is_folder(path):
            shutil.rmtree(path, ignore_errors=True)
        else:
            os.unlink(path)


def remove_own(folder: Path, token: str) -> None:
    """Remove a folder of this owner, or one that nobody has put anything into yet, and nothing else."""
    if owner(folder) == token:
        remove(folder)
    elif is_folder(folder):
        with contextlib.suppress(OSError):
            os.rmdir(folder)  # killed before it was marked; fails where there is anything in it


def _stat(path: Path) -> os.stat_result | None:
    try:
        return os.lstat(path)
    except (OSError, ValueError):
        return None


def _is_junction(status: os.stat_result) -> bool:
    return getattr(status, "st_reparse_tag", 0) == _JUNCTION
