"""How far the work is, for people (a bar) and for programs (JSON lines), with the time left.

The time left is the present stage's, at its measured pace, plus what the later stages are expected to take.
"""

from __future__ import annotations

import errno
import math
import sys
import threading
import time
from collections.abc import Mapping

from dante_w.contract.errors import Cancelled
from dante_w.contract.protocol import Message, Step, encode

#: A line at least this often, so that a reader can tell slow from dead.
HEARTBEAT_SECONDS = 1.0
#: At most this many lines a second.
SHORTEST_INTERVAL = 0.1
BAR_WIDTH = 28


class Progress:
    """Reports stages in order. `expected` gives each stage's expected seconds and can be refined on the way."""

    def __init__(self, as_json: bool) -> None:
        self.expected: dict[str, float] = {}
        self.seconds: dict[str, float] = {}
        self.as_json = as_json
        self._lock = threading.Lock()
        self._stage, self._began, self._written = "", time.monotonic(), 0.0
        self._latest: Step | None = None

    def expect(self, seconds: Mapping[str, float]) -> None:
        """Say how long coming stages will take, in their order."""
        self.expected = dict(seconds)

    def update(self, stage: str, step: float, total: float, loss: float | None = None) -> None:
        """Report `step` of `total`; the first report of a stage begins it."""
        now = time.monotonic()
        if stage != self._stage:
            self.close()
            self._stage, self._began, self._written = stage, now, 0.0
        if loss is None and self._latest and self._latest.stage == stage:
            loss = self._latest.loss
        finite = loss if loss is not None and math.isfinite(loss) else None
        left = self._seconds_left(now, step / total if total else 1.0)
        self._latest = Step(stage, step, total, finite, left)
        if now - self._written >= SHORTEST_INTERVAL or step >= total:
            self.write()

    def close(self) -> None:
        """End the present stage and note its seconds."""
        if self._stage:
            spent = time.monotonic() - self._began
            self.seconds[self._stage] = round(self.seconds.get(self._stage, 0.0) + spent, 3)
            if not self.as_json and sys.stderr.isatty():
                print(file=sys.stderr)
        self._stage = ""

    def write(self) -> None:
        """Write the latest report (again)."""
        self._written = time.monotonic()
        if not self._latest:
            return
        if self.as_json:
            self.say(self._latest)
        elif sys.stderr.isatty():
            sys.stderr.write("\r" + _bar(self._latest))
            sys.stderr.flush()

    def beat(self) -> None:
        """Repeat the latest report if it has been silent for a while."""
        if self.as_json and time.monotonic() - self._written >= HEARTBEAT_SECONDS:
            self.write()

    def say(self, message: Message) -> None:
        """Print a message as one JSON line.

        Raises:
            Cancelled: nobody reads any more.
        """
        try:
            with self._lock:
                print(encode(message), flush=True)
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EINVAL):  # the second is Windows'
                raise
            raise Cancelled("Cancelled: nobody reads the progress any more.") from error

    def _seconds_left(self, now: float, done: float) -> float | None:
        later, found = 0.0, False
        for stage, seconds in self.expected.items():
            if found:
                later += seconds
            found = found or stage == self._stage
        spent = now - self._began
        if done > 0.02 and spent > 0.5:
            return round(spent / done * (1.0 - done) + later, 1)
        if found and self.expected:
            return round(self.expected[self._stage] * (1.0 - done) + later, 1)
        return None


def _bar(latest: Step) -> str:
    done = latest.step / latest.total if latest.total else 1.0
    filled = int(BAR_WIDTH * min(done, 1.0))
    text = f"{latest.stage:>10} [{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {100 * done:5.1f}%"
    if latest.loss is not None:
        text += f"  loss {latest.loss:.4f}"
    if latest.seconds_left is not None:
        minutes, seconds = divmod(round(latest.seconds_left), 60)
        text += f"  {minutes}:{seconds:02d} left"
    return text.ljust(78)
