"""The result folder: everything is staged inside it and renamed into place, the report last.

A folder without a report is not a whole result.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

from dante_w.errors import BadInput

REPORT = "report.json"
_STAGING = ".partial"


def stage(out: Path) -> Path:
    """Make `out` and an empty staging folder in it; returns that.

    Raises:
        BadInput: `out` cannot be written to.
    """
    staging = out / _STAGING
    try:
        shutil.rmtree(staging, ignore_errors=True)  # left by a process that was killed
        staging.mkdir(parents=True)
    except OSError as error:
        if is_full(error):
            raise
        raise BadInput(f"{out}: cannot write here ({error.strerror}); choose another --out.") from error
    return staging


def publish(out: Path) -> None:
    """Rename what was staged into place and remove the rest."""
    staging = out / _STAGING
    (out / REPORT).unlink(missing_ok=True)  # from here to the last rename the folder is not whole
    names = sorted(path.name for path in staging.iterdir() if path.is_file())
    for name in sorted(names, key=lambda name: name == REPORT):
        os.replace(staging / name, out / name)
    shutil.rmtree(staging)  # with the ray cache, where that went to disk


def abandon(out: Path) -> None:
    """Remove the staging folder, and `out` if that leaves it empty; never raises."""
    shutil.rmtree(out / _STAGING, ignore_errors=True)
    with contextlib.suppress(OSError):
        out.rmdir()


def is_full(error: BaseException) -> bool:
    """Whether an error says that the disk is full."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
