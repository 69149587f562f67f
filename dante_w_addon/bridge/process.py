"""A subprocess that speaks JSON lines, read by threads so that nobody ever waits on it. Knows no bpy."""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

#: Seconds between the polite request to end and the end.
GRACE = 0.8
#: Seconds of silence after which the user is told; the backend promises a line a second.
SILENCE = 20.0
STAGES = {
    "traced": ("scene", "unwrap", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"),
    "field": ("scene", "unwrap", "rays", "optimise", "held-out", "final pass", "bake", "write"),
}
CANCELLED = 3


def clean_environment() -> dict[str, str]:
    """The environment without what Blender or the user set for *their* Python."""
    return {key: value for key, value in os.environ.items() if not key.upper().startswith("PYTHON")}


class Process:
    """A command in a process group of its own.

    Attributes:
        cancelled: whether `cancel` was called.
    """

    def __init__(self, command: Sequence[str]) -> None:
        """Start `command`; raises OSError where that fails."""
        self.cancelled = False
        self._messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._log: deque[str] = deque(maxlen=200)
        self._popen = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=clean_environment(),
            encoding="utf-8",
            errors="replace",
            **_own_group(),
        )
        self._readers = [
            threading.Thread(target=self._read, args=(stream, parse), daemon=True)
            for stream, parse in ((self._popen.stdout, True), (self._popen.stderr, False))
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        return self._popen.pid

    @property
    def returncode(self) -> int | None:
        """Exit status once the process has ended and all it wrote has been read, else None."""
        if self._popen.poll() is None:
            return None
        if any(reader.is_alive() for reader in self._readers) and not self.cancelled:
            return None
        return self._popen.returncode

    def messages(self) -> list[dict[str, Any]]:
        """The JSON lines that arrived since the last call."""
        result = []
        with contextlib.suppress(queue.Empty):
            while True:
                result.append(self._messages.get_nowait())
        return result

    def last_lines(self, count: int = 6) -> list[str]:
        """The end of the log, for when it crashed."""
        return list(self._log)[-count:]

    def cancel(self) -> None:
        """End the whole process group, within GRACE seconds, without waiting for it here."""
        if self.cancelled:
            return
        self.cancelled = True
        self._signal(polite=True)
        threading.Thread(target=self._make_sure, daemon=False).start()

    def kill(self) -> None:
        """End the whole process group now; for when Blender itself goes away."""
        self.cancelled = True
        self._signal(polite=False)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(1.0)

    def _make_sure(self) -> None:
        deadline = time.monotonic() + GRACE
        while self._group_alive() and time.monotonic() < deadline:
            time.sleep(0.02)
        self._signal(polite=False)
        self._popen.wait()

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

    def _read(self, stream: Any, parse: bool) -> None:
        with contextlib.suppress(ValueError, OSError), stream:
            for line in stream:
                message = _parse(line) if parse else None
                if message is not None:
                    self._messages.put(message)
                elif line.strip():
                    self._log.append(line.rstrip())


def _own_group() -> dict[str, Any]:
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def _parse(line: str) -> dict[str, Any] | None:
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) and "stage" in message else None


def decisions(plan: Any) -> list[dict[str, str]]:
    """The lines of a plan that say `what` is decided, the `choice` and its `reason`; others are left out."""
    said = ("what", "choice", "reason")
    lines = plan if isinstance(plan, list) else []
    return [
        line for line in lines if isinstance(line, dict) and all(isinstance(line.get(k), str) for k in said)
    ]


def _number(value: Any) -> float | None:
    """A finite number, or None."""
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


@dataclass
class Progress:
    """How far the backend is, from its messages and its end."""

    state: str = "running"  # running, done, failed, cancelled
    stage: str = "scene"
    step: float = 0.0
    total: float = 0.0
    loss: float | None = None
    seconds_left: float | None = None
    expected: dict[str, Any] = field(default_factory=dict)
    plan: list[dict[str, str]] = field(default_factory=list)
    out: str = ""
    report: dict[str, Any] = field(default_factory=dict)
    code: int = 0
    message: str = ""
    heard: float = field(default_factory=time.monotonic)

    @property
    def fraction(self) -> float:
        """Part of the present stage that is done."""
        return min(max(self.step / self.total, 0.0), 1.0) if self.total else 0.0

    @property
    def place(self) -> tuple[int, int]:
        """Number of the present stage, 0 if unknown, and how many there are, whichever model runs."""
        stages = next((own for own in STAGES.values() if self.stage in own), ())
        return (stages.index(self.stage) + 1 if stages else 0), len(stages)

    @property
    def silent(self) -> float:
        """Seconds since the last message, where that is longer than it should be, else 0."""
        seconds = time.monotonic() - self.heard
        return seconds if self.state == "running" and seconds > SILENCE else 0.0

    def follow(self, process: Process) -> list[dict[str, Any]]:
        """Take in what `process` said and whether it ended; returns the new messages."""
        code = process.returncode  # before the messages, so that none comes after the end
        messages = process.messages()
        for message in messages:
            self._take(message)
        if code is not None and self.state == "running":
            self._end(code, process)
        return messages

    def _take(self, message: dict[str, Any]) -> None:
        self.heard = time.monotonic()
        if message["stage"] == "done":
            self.out, self.report = str(message.get("out", "")), dict(message.get("report") or {})
        elif message["stage"] == "error":
            self.code, self.message = int(message.get("code", 1)), str(message.get("message", ""))
        elif message["stage"] == "expected":
            self.expected = {key: value for key, value in message.items() if key != "stage"}
        elif message["stage"] == "planned":
            self.plan = decisions(message.get("decisions"))
        else:
            self.stage = str(message["stage"])
            self.step, self.total = _number(message.get("step")) or 0.0, _number(message.get("total")) or 0.0
            self.seconds_left = _number(message.get("seconds_left"))
            loss = _number(message.get("loss"))
            self.loss = self.loss if loss is None else loss

    def _end(self, code: int, process: Process) -> None:
        if process.cancelled or code == CANCELLED:
            self.state, self.code, self.message = "cancelled", CANCELLED, "Cancelled."
        elif code == 0 and self.out:
            self.state, self.code = "done", 0
        else:
            self.state = "failed"
            self.code = code if code > 0 else 1
            if not self.message:
                lines = process.last_lines()
                self.message = "\n".join([f"The backend stopped with status {code}.", *lines])
