"""Run one command so that it ends cleanly, whatever happens to it.

The work runs in a thread of its own while the main thread waits for signals: SIGINT and SIGTERM take effect within
a second even while a library computes, because the process then removes its staging folder and leaves.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from dante_w.contract.errors import BUG, CANCELLED, DONE, OUT_OF_ROOM, DanteError, OutOfRoom
from dante_w.contract.protocol import Done, Failed
from dante_w.options import Call, RecoverOptions
from dante_w.run import distributed
from dante_w.run.progress import Progress
from dante_w.run.result_files import names_to_write
from dante_w.run.result_folder import abandon, is_full, publish, stage
from dante_w.run.scratch import discard, scratch

if TYPE_CHECKING:  # it imports torch, which takes seconds: signals come first
    from dante_w.presets import Preset

#: What ends a run early: Ctrl-C, a polite kill, a closed terminal, and how Windows ends a process group.
SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
]
CANCELLED_RUN = "Cancelled; the former result, if any, is untouched."
#: Bytes of address space that loading torch, numba and the others takes, and some more.
LOADING = 3 << 29
#: What libraries say when memory runs out.
_NO_MEMORY = ("allocat", "out of memory", "can't start new thread", "failed to map segment", "bad_alloc")


def run(call: Call, leave: Callable[[int], Any] = os._exit, settings: Preset | None = None) -> int:
    """Run `recover`, `average` or `plan`; returns the exit code, or calls `leave` with it where a thread is still at work."""
    if distributed.rank() > 0:  # the first process speaks
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    progress, options = Progress(call.json), call.options
    outcome: dict[str, Any] = {}
    finished = threading.Event()
    cancelled = threading.Event()
    publishing = threading.Lock()

    def cancel(*_: Any) -> None:
        cancelled.set()
        finished.set()

    listen(cancel)

    def work() -> None:
        try:
            report = _work(call, progress, settings)
            with publishing:
                if options.out is None or distributed.rank() > 0:
                    discard(os.getpid())
                else:
                    publish(options.out)
                outcome["report"] = report
        except BaseException as error:
            outcome["error"] = error
        finally:
            finished.set()

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    while not finished.wait(0.2):
        try:
            progress.beat()
            distributed.check()
        except (DanteError, OSError) as error:
            outcome.setdefault("error", error)
            finished.set()
    publishing.acquire()  # a result that is being put into place is finished, whatever comes
    for number in SIGNALS:  # from here on it is decided how this ends
        signal.signal(number, signal.SIG_IGN)
    if "report" in outcome:
        told = _say_done(call, progress, outcome["report"])
        return DONE if told else _leave(DONE, leave)
    clear(options, os.getpid())
    if cancelled.is_set():
        return _leave(fail(call.json, CANCELLED, CANCELLED_RUN), leave)
    code = _explain(call.json, distributed.cause(outcome["error"]))
    return _leave(code, leave) if worker.is_alive() else code


def listen(handler: Callable[..., None]) -> None:
    """Have `handler` called by what ends a run early; a closed terminal does not where nohup said so."""
    for number in SIGNALS:
        if number != getattr(signal, "SIGHUP", None) or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def clear(options: RecoverOptions, process: int) -> None:
    """Remove what a run in `process` has not finished."""
    if options.out is None or distributed.rank() > 0:
        discard(process)
    else:
        abandon(options.out)


def _work(call: Call, progress: Progress, settings: Preset | None) -> dict[str, Any]:
    progress.update("scene", 0, 1)
    _make_sure_of_room()
    from dante_w.commands import recover  # torch takes seconds to import; signals already work

    options = call.options
    if distributed.rank() > 0 and options.out is not None:
        options = replace(options, out=scratch())
    if options.out is None:
        staging = scratch()
    else:
        staging = stage(options.out, names_to_write(options.format, options.unwrap))
    if call.command == "average":
        return recover.average(options, staging, progress)
    work = recover.recover_into if call.command == "recover" else recover.plan
    return work(options, staging, progress, settings)


def _make_sure_of_room() -> None:
    """Libraries that find no memory while they are loaded crash, or wait for it for ever.

    Raises:
        OutOfRoom: they would.
    """
    try:
        mmap.mmap(-1, LOADING).close()
    except (OSError, MemoryError) as error:
        raise OutOfRoom("There is no 1.5 GB of memory to begin with; close other programs.") from error


def _say_done(call: Call, progress: Progress, report: dict[str, Any]) -> bool:
    """Whether anybody still reads."""
    out = call.options.out
    if call.json:
        try:
            progress.say(Done(report, str(out.resolve()) if out else ""))
        except (DanteError, OSError):  # nobody reads any more: the result stands all the same
            return False
    elif out is not None:
        print(f"done: {out}")
    return True


def _leave(code: int, leave: Callable[[int], Any]) -> int:
    """Leave at once: the working thread may be deep in a library and must not hold the process."""
    import psutil

    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            child.kill()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    leave(code)
    return code


def _explain(as_json: bool, error: BaseException) -> int:
    if isinstance(error, DanteError):
        return fail(as_json, error.exit_code, str(error))
    causes = list(_chain(error))
    if any(_is_memory(cause) for cause in causes):
        return fail(as_json, OUT_OF_ROOM, "Out of memory; choose a smaller --texture-size or preset.")
    full = next((cause for cause in causes if is_full(cause)), None)
    if full is not None:
        where = getattr(full, "filename", None) or "the result folder"
        return fail(as_json, OUT_OF_ROOM, f"{where}: the disk is full; free some space and run again.")
    with contextlib.suppress(OSError):
        traceback.print_exception(error, file=sys.stderr)
    return fail(
        as_json, BUG, f"Internal error ({type(error).__name__}: {error}); please report it with the log."
    )


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error and what it came from."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _is_memory(error: BaseException) -> bool:
    """Whether memory ran out, on any device: numpy, torch, numba and the system each say it in their own way."""
    return isinstance(error, MemoryError) or any(words in str(error).lower() for words in _NO_MEMORY)


def fail(as_json: bool, code: int, message: str) -> int:
    """Say why a run ends, in one sentence; returns `code`."""
    if distributed.rank() > 0:
        if code != CANCELLED:
            distributed.tell(code, message)
        return code
    with contextlib.suppress(DanteError, OSError):  # nobody reads any more: the exit code still tells
        if as_json:
            Progress(True).say(Failed(code, message))
        else:
            print(f"dante-w: {message}", file=sys.stderr)
    return code
