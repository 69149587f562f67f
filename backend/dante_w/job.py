"""Run one command so that it ends cleanly, whatever happens to it.

The work runs in a thread of its own while the main thread waits for signals: SIGINT and SIGTERM take effect within
a second even while a library computes, because the process then removes its staging folder and leaves.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
import traceback
from typing import Any

from dante_w.errors import BUG, CANCELLED, DONE, OUT_OF_ROOM, DanteError
from dante_w.progress import Progress
from dante_w.result_folder import abandon, is_full, publish, stage


def run(command: str, options: argparse.Namespace) -> int:
    """Run `recover`, `average` or `plan`; returns the exit code."""
    progress = Progress(options.json)
    outcome: dict[str, Any] = {}
    finished = threading.Event()
    cancelled = threading.Event()
    publishing = threading.Lock()

    def cancel(*_: Any) -> None:
        cancelled.set()
        finished.set()

    for name in ("SIGINT", "SIGTERM", "SIGBREAK"):  # SIGBREAK is how Windows ends a process group
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), cancel)

    def work() -> None:
        try:
            report = _work(command, options, progress)
            with publishing:
                if command == "plan":
                    abandon(options.out)
                else:
                    publish(options.out)
                outcome["report"] = report
        except BaseException as error:
            outcome["error"] = error
        finally:
            finished.set()

    threading.Thread(target=work, daemon=True).start()
    while not finished.wait(0.2):
        progress.beat()
    publishing.acquire()  # a result that is being put into place is finished, whatever comes
    if cancelled.is_set() and "report" not in outcome:
        abandon(options.out)
        return _leave(_fail(options.json, CANCELLED, "Cancelled; the former result, if any, is untouched."))
    if "error" in outcome:
        abandon(options.out)
        return _explain(options.json, outcome["error"])
    if command == "plan":
        if options.json:
            progress.say({"stage": "done", "report": outcome["report"]})
    elif options.json:
        progress.say({"stage": "done", "out": str(options.out.resolve()), "report": outcome["report"]})
    else:
        print(f"done: {options.out}")
    return DONE


def _work(command: str, options: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from dante_w import recover  # torch takes seconds to import; signals already work

    progress.update("scene", 0, 1)
    staging = stage(options.out)
    report: dict[str, Any] = {"recover": recover.recover, "average": recover.average, "plan": recover.plan}[
        command
    ](options, staging, progress)
    return report


def _leave(code: int) -> int:
    """Leave at once: the working thread may be deep in a library and must not hold the process."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _explain(as_json: bool, error: BaseException) -> int:
    if isinstance(error, DanteError):
        return _fail(as_json, error.exit_code, str(error))
    if isinstance(error, MemoryError) or "allocate" in str(error) or "out of memory" in str(error).lower():
        return _fail(as_json, OUT_OF_ROOM, "Out of memory; choose a smaller --texture-size or preset.")
    if is_full(error):
        where = getattr(error, "filename", None) or "the result folder"
        return _fail(as_json, OUT_OF_ROOM, f"{where}: the disk is full; free some space and run again.")
    traceback.print_exception(error, file=sys.stderr)
    return _fail(
        as_json, BUG, f"Internal error ({type(error).__name__}: {error}); please report it with the log."
    )


def _fail(as_json: bool, code: int, message: str) -> int:
    if as_json:
        with contextlib.suppress(BrokenPipeError):  # nobody reads any more: the exit code still tells
            Progress(True).say({"stage": "error", "code": code, "message": message})
    else:
        print(f"dante-w: {message}", file=sys.stderr)
    return code
