"""A subprocess that writes JSON lines, read without waiting and without threads. Knows no bpy.

Its pipes are read whenever the owner asks, from a timer or a loop. Pipes rather than files: a backend whose Blender was
killed finds that nobody reads its lines any more, and ends.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import IO, Any

from ..contract.protocol import Message, decode

if sys.platform == "win32":
    import _winapi
    import msvcrt

#: Seconds between the polite request to end and the end.
GRACE = 0.8
#: Lines of the log that are kept.
LOG_LINES = 200
READ_BYTES = 1 << 16
#: Reads of a pipe at a time: more than it holds, yet a process that never stops writing does not hold Blender up.
READS = 16


def clean_environment() -> dict[str, str]:
    """The environment without what Blender or the user set for *their* Python."""
    return {key: value for key, value in os.environ.items() if not key.upper().startswith("PYTHON")}


class Process:
    """A command in a process group of its own. Whoever starts it looks at `returncode` now and then, which also reads
    what it wrote and sees a cancelled one to its end.

    Attributes:
        cancelled: whether it was asked to end.
    """

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        variables: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Start `command`, with `variables` in its environment.

        Raises:
            OSError: it cannot be started.
        """
        self.cancelled = False
        self._deadline = 0.0
        self._messages: list[Message] = []
        self._log: deque[str] = deque(maxlen=LOG_LINES)
        self._popen = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env={**clean_environment(), **variables},
            **_own_group(),
        )
        self._output, self._errors = Lines(self._popen.stdout), Lines(self._popen.stderr)

    @property
    def pid(self) -> int:
        """Number of the process, and of its group."""
        return self._popen.pid

    @property
    def returncode(self) -> int | None:
        """Exit status once the process has ended and all it wrote has been read, else None.

        A cancelled process has ended when its whole group is gone. What is left of it after GRACE seconds is killed here.
        """
        is_over = self._popen.poll() is not None  # before reading: a process that is over writes no more
        self._read(last=is_over)
        if self.cancelled and self._group_alive():
            if time.monotonic() < self._deadline:
                return None
            self._signal(polite=False)
        return self._popen.returncode if is_over else None

    def messages(self) -> list[Message]:
        """The messages that arrived since the last call."""
        self._read()
        messages, self._messages = self._messages, []
        return messages

    def last_lines(self, count: int = 6) -> list[str]:
        """The end of the log: lines that are no messages."""
        return list(self._log)[-count:]

    def cancel(self) -> None:
        """Ask the whole process group to end, without waiting for it here."""
        if not self.cancelled and self.returncode is None:
            self.cancelled, self._deadline = True, time.monotonic() + GRACE
            self._signal(polite=True)

    def close(self) -> None:
        """End the whole process group and wait until it is gone, which takes GRACE seconds at most and a moment."""
        self.cancel()
        while self.returncode is None and time.monotonic() < self._deadline + 1.0:
            time.sleep(0.01)

    def kill(self) -> None:
        """End the whole process group now."""
        self.cancelled = True
        self._signal(polite=False)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(1.0)

    def _read(self, last: bool = False) -> None:
        for line in self._output.read(last):
            message = decode(line)
            if message is not None:
                self._messages.append(message)
            elif line.strip():
                self._log.append(line.rstrip())
        self._log.extend(line.rstrip() for line in self._errors.read(last) if line.strip())

    def _group_alive(self) -> bool:
        if self._popen.poll() is None:
            return True
        if sys.platform == "win32":
            return False
        try:
            os.killpg(self._popen.pid, 0)
        except (ProcessLookupError, PermissionError):
            return False
        return True

    def _signal(self, polite: bool) -> None:
        if sys.platform == "win32":
            if polite:
                with contextlib.suppress(OSError):
                    self._popen.send_signal(signal.CTRL_BREAK_EVENT)
            elif self._popen.poll() is None:
                subprocess.run(
                    ["taskkill", "/T", "/F", "/PID", str(self._popen.pid)],
                    capture_output=True,
                    check=False,
                    creationflags=subprocess.CREATE_NO_WINDOW,
                )
            return
        # The group outlives its leader while a child of it runs, and its number is not reused until then.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._popen.pid, signal.SIGTERM if polite else signal.SIGKILL)


class Lines:
    """The lines of a pipe, as far as they have arrived."""

    def __init__(self, pipe: IO[bytes]) -> None:
        """Take over `pipe`, the reading end."""
        self._pipe, self._rest = pipe, b""
        if sys.platform != "win32":
            os.set_blocking(pipe.fileno(), False)

    def read(self, last: bool = False) -> list[str]:
        """Whole lines that arrived since the last call, without their ends. `last`: nothing more is to come, so what has no
        end is a line as well; a child of an ended process may still hold the pipe open."""
        for _ in range(READS):
            data = None if self._pipe.closed else read_now(self._pipe.fileno())
            if not data:
                break
            self._rest += data
        if last or data == b"":
            self._pipe.close()
        *lines, self._rest = self._rest.split(b"\n")
        if self._pipe.closed and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        return [line.decode("utf-8", "replace") for line in lines]


def read_now(descriptor: int) -> bytes | None:
    """What a pipe holds: b"" at its end, None where nothing has arrived. Never waits."""
    try:
        if sys.platform == "win32":  # Python 3.11 cannot make pipes non-blocking there
            size = _winapi.PeekNamedPipe(msvcrt.get_osfhandle(descriptor), 0)[0]
            return os.read(descriptor, min(size, READ_BYTES)) if size else None
        return os.read(descriptor, READ_BYTES)
    except BlockingIOError:
        return None
    except OSError:  # Windows says so when the other end is closed
        return b""


def _own_group() -> dict[str, Any]:
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}
