"""The errors a user can meet, each with its exit code. Anything else is a bug and exits with 1."""

from __future__ import annotations

DONE, BUG, BAD_INPUT, CANCELLED, OUT_OF_ROOM = 0, 1, 2, 3, 4


class DanteError(Exception):
    """An expected failure: one sentence for the user that names the file and the fix."""

    exit_code = BUG


class BadInput(DanteError):
    """The scene, a file in it or an option cannot be used as it is."""

    exit_code = BAD_INPUT


class OutOfRoom(DanteError):
    """Memory or disk ran out."""

    exit_code = OUT_OF_ROOM


class Cancelled(DanteError):
    """Whoever asked for the result is gone."""

    exit_code = CANCELLED
