"""Which files a result has, which of those in a folder an earlier run wrote, and what may be replaced.

A result never replaces a file that no earlier run wrote, nor one that the run reads. An earlier run's files are those that its
report lists. A link is nobody's result: where a file belongs, it is refused like any file of the user.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable
from pathlib import Path

from dante_w.contract.errors import BadInput
from dante_w.contract.report import COVERAGE, MESH, REPORT, albedo_file
from dante_w.run.own_folders import is_file

#: Every file that a result can have, the report last.
FILES = (albedo_file("png"), albedo_file("exr"), COVERAGE, MESH, REPORT)


def names_to_write(file_format: str, unwrap: bool) -> tuple[str, ...]:
    """The files of a result in this format, with a mesh of its own or not."""
    return (albedo_file(file_format), COVERAGE, *([MESH] if unwrap else []), REPORT)


def names_in(folder: Path) -> list[str]:
    """The files of a result that are in a folder, in the order of `FILES`."""
    return [name for name in FILES if is_file(folder / name)]


def names_written(report: Path) -> list[str]:
    """The files that were written with a report, in the order of `FILES`; none if it is not a report of ours.

    Reports of version 0.1 have no list of `files`; theirs are known from the settings.
    """
    if not is_file(report):
        return []
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    if not isinstance(content, dict) or not isinstance(content.get("dante_w"), str):
        return []
    names, settings = content.get("files"), content.get("settings")
    if not isinstance(names, list):
        unwrapped = isinstance(settings, dict) and settings.get("unwrap") is True
        names = [name for name in FILES if name != MESH or unwrapped]
    return [name for name in FILES if name in names]


def refuse_foreign(out: Path, names: Iterable[str], own: Iterable[str]) -> None:
    """Refuse to replace what an earlier run did not write.

    Args:
        names: files that are to be written into `out`.
        own: those of them that an earlier run wrote there.

    Raises:
        BadInput: something else has one of these names.
    """
    for name in names:
        path = out / name
        if os.path.lexists(path) and not (name in own and is_file(path)):
            raise BadInput(
                f"{path}: was not written by an earlier run, so it is not replaced; choose another --out."
            )


def refuse_inputs(out: Path, inputs: Iterable[Path]) -> None:
    """Refuse a result folder whose former result is read by the run that would replace or remove it.

    Files are compared as the system knows them, so another spelling, a link or a hard link of an input is found, too.

    Raises:
        BadInput: a file of the former result in `out` is among the `inputs`.
    """
    identities = set()
    for path in inputs:
        with contextlib.suppress(OSError):  # whoever reads it will say so
            status = os.stat(path)
            identities.add((status.st_dev, status.st_ino))
    for name in names_written(out / REPORT):
        with contextlib.suppress(FileNotFoundError):
            status = os.lstat(out / name)
            if (status.st_dev, status.st_ino) in identities:
                raise BadInput(
                    f"{out / name}: is read by this run, whose result would replace it; choose another --out."
                )
