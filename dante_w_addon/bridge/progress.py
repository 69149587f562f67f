"""How far a run of the backend is, from its messages and its end. Knows no bpy."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from ..contract.errors import BUG, CANCELLED, DONE
from ..contract.protocol import Decision, Done, Expected, Failed, Message, Planned, Step
from ..contract.vocabulary import STAGES
from .process import Process

#: Seconds of silence after which the user is told; the backend promises a line a second.
SILENCE = 20.0


@dataclass
class Progress:
    """The state of a run.

    Attributes:
        state: `running`, `done`, `failed` or `cancelled`.
        step: the latest message about the present stage.
        loss: of the paper's model, the latest that is known.
        expected: what the backend expects the run to take.
        plan: what is modelled, and why.
        out, report: the result folder and its report, once it is done.
        code, message: the exit code and a sentence for the user, once the run has ended.
        last_time: when the last message came, in seconds of the monotonic clock.
    """

    state: str = "running"
    step: Step = field(default_factory=lambda: Step("scene", 0.0, 0.0))
    loss: float | None = None
    expected: Expected | None = None
    plan: tuple[Decision, ...] = ()
    out: str = ""
    report: dict[str, Any] = field(default_factory=dict)
    code: int = DONE
    message: str = ""
    last_time: float = field(default_factory=time.monotonic)

    @property
    def stage_number(self) -> tuple[int, int]:
        """Number of the present stage, 0 if unknown, and how many there are, whichever model runs."""
        stages = next((stages for stages in STAGES.values() if self.step.stage in stages), ())
        return (stages.index(self.step.stage) + 1 if stages else 0), len(stages)

    @property
    def silent(self) -> float:
        """Seconds since the last message, where that is longer than it should be, else 0."""
        seconds = time.monotonic() - self.last_time
        return seconds if self.state == "running" and seconds > SILENCE else 0.0

    def follow(self, process: Process) -> list[Message]:
        """Take in what `process` wrote and whether it ended; returns the new messages."""
        code = process.returncode  # before the messages, so that none comes after the end
        messages = process.messages()
        for message in messages:
            self._take(message)
        if code is not None and self.state == "running":
            self._end(code, process)
        return messages

    def _take(self, message: Message) -> None:
        self.last_time = time.monotonic()
        match message:
            case Done(report, out):
                self.report, self.out = report, out
            case Failed(code, sentence):
                self.code, self.message = code, sentence
            case Expected():
                self.expected = message
            case Planned(decisions):
                self.plan = decisions
            case Step():
                self.step = message
                self.loss = self.loss if message.loss is None else message.loss

    def _end(self, code: int, process: Process) -> None:
        if process.cancelled or code == CANCELLED:
            self.state, self.code, self.message = "cancelled", CANCELLED, "Cancelled."
        elif code == DONE and self.out:
            self.state, self.code = "done", DONE
        else:
            self.state, self.code = "failed", code if code > 0 else BUG
            if not self.message:
                log = process.last_lines()
                self.message = "\n".join([f"The backend stopped with status {code}.", *log])
