"""Commands that run one after the other, for setting the backend up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from .process import Process

#: Lines of a command's log that are kept for the panel.
LINES = 12


@dataclass
class Task:
    """A list of commands at work.

    Attributes:
        title: what it does, for people.
        commands: those that have not begun.
        when_done: called when all of them ended well.
        state: `running`, `done`, `failed` or `stopped`.
        lines: the end of the present command's log.
    """

    title: str
    commands: list[list[str]]
    when_done: Callable[[], None] = lambda: None
    process: Process | None = None
    state: str = "running"
    lines: list[str] = field(default_factory=list)

    def update(self) -> bool:
        """Start the next command when one ends well. Returns whether it still runs."""
        if self.process is not None:
            code = self.process.returncode
            self.lines = self.process.last_lines(LINES)
            if code is None:
                return True
            if code != 0 or self.process.cancelled:
                self.state = "stopped" if self.process.cancelled else "failed"
                return False
        if not self.commands:
            self.state = "done"
            self.when_done()
            return False
        try:
            self.process = Process(self.commands.pop(0))
        except OSError as error:
            self.state, self.lines = "failed", [str(error)]
            return False
        return True
