"""The command's first process: it does no work but starts it, outlives it, and says what happened to it.

A library that runs out of memory may abort the whole process, and the system may kill it. The work therefore runs
in a second process; this one imports nothing heavy, so nothing happens to it. If it is killed itself, the second process
finds its standard input closed and leaves as if it had been cancelled.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from dante_w.commands import cli
from dante_w.commands.worker import clear, fail, listen
from dante_w.contract.errors import BUG, CANCELLED, DONE, OUT_OF_ROOM

_WORK = "import sys; sys.path.insert(0, sys.argv.pop(1)); from dante_w.commands import supervisor; sys.exit(supervisor.guarded())"
_SOURCES = str(Path(__file__).resolve().parents[2])
#: Added to the work's own exit codes: libraries use the plain ones, too, when they give up.
_SAID = 64
#: How Windows says that memory ran out.
_WINDOWS_NO_MEMORY = (0xC0000017, 0xC000012D)


def main() -> int:
    """Run the command of `sys.argv`; returns its exit code."""
    call = cli.parse()
    if call.command == "doctor":
        return cli.main()
    isolated = ["-I"] if sys.flags.isolated else ["-P"]
    command = [sys.executable, *isolated, "-X", f"utf8={sys.flags.utf8_mode}", "-c", _WORK, _SOURCES]
    work = subprocess.Popen([*command, *sys.argv[1:]], stdin=subprocess.PIPE)

    def pass_on(number: int, _: Any) -> None:
        if sys.platform != "win32":  # Windows tells every process of a group
            work.send_signal(number)

    listen(pass_on)
    code = work.wait()
    if DONE <= code - _SAID <= OUT_OF_ROOM:
        return code - _SAID
    clear(call.options, work.pid)
    return fail(call.json, *_meaning(code))


def guarded() -> int:
    """The work itself, in the process that `main` starts."""
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    return _SAID + cli.main(leave=lambda code: os._exit(_SAID + code))


def _leave_with_parent() -> None:
    while os.read(0, 4096):
        pass
    signal.raise_signal(signal.SIGTERM)


def _meaning(code: int) -> tuple[int, str]:
    """Exit code and sentence for a process that ended with an exit status of nobody's making."""
    how = signal.Signals(-code).name if -code in signal.valid_signals() else f"status {code}"
    if how == "SIGBUS":  # a mapped file met the end of the disk
        return OUT_OF_ROOM, "The disk is full; free some space and run again."
    if how in ("SIGKILL", "SIGABRT", "status 1", "status 127") or code in _WINDOWS_NO_MEMORY:
        return OUT_OF_ROOM, (
            f"The work was ended from outside or by a library ({how}), as happens when memory runs out; "
            "close other programs or choose a smaller --texture-size or preset."
        )
    if how in ("SIGTERM", "SIGINT", "SIGHUP"):  # before the work could listen
        return CANCELLED, "Cancelled; the former result, if any, is untouched."
    return BUG, f"Internal error (a library ended the work with {how}); please report it with the log."
