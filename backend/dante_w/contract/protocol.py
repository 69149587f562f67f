"""The JSON lines that a run writes on its standard output, one object a line.

The backend writes `encode(message)`; the add-on reads `decode(line)`. A reader passes over lines that it does not know and
fields that it cannot use, so that either side may be older than the other.

>>> decode(encode(Step("lights", 3, 16, None, 41.5)))
Step(stage='lights', step=3.0, total=16.0, loss=None, seconds_left=41.5)
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Step:
    """How far the present stage is: `step` of `total`; the fit's `loss`, and the run's `seconds_left`, where they are known."""

    stage: str
    step: float
    total: float
    loss: float | None = None
    seconds_left: float | None = None

    @property
    def fraction(self) -> float:
        """Part of the stage that is done, in [0, 1]."""
        return min(max(self.step / self.total, 0.0), 1.0) if self.total else 0.0


@dataclass(frozen=True)
class Quality:
    """Albedo PSNR in dB after one gain per channel, in test views of rendered objects: the mean and the range."""

    mean: float
    lowest: float
    highest: float


@dataclass(frozen=True)
class Expected:
    """What a run will take: `seconds` of each stage, those behind it included; and what its preset reached on the benchmark's
    objects, where that was measured."""

    seconds: dict[str, float]
    total_seconds: float
    albedo_psnr_after_gain: Quality | None = None


#: Reason of a decision that the user took.
YOU_CHOSE = "you chose it"


@dataclass(frozen=True)
class Decision:
    """One line of the plan: `what` is decided, the `choice`, the `reason`, and what it `costs`."""

    what: str
    choice: str
    reason: str
    costs: str = ""


@dataclass(frozen=True)
class Planned:
    """What a run models, and why."""

    decisions: tuple[Decision, ...]


@dataclass(frozen=True)
class Done:
    """The end of a run that went well. `out`: absolute path of the result folder, empty where there is none (a plan).
    `object_name`: the object that has the result, where Blender ran the command."""

    report: dict[str, Any] = field(default_factory=dict)
    out: str = ""
    object_name: str = ""


@dataclass(frozen=True)
class Failed:
    """The end of any other run: its exit code and one sentence for the user."""

    code: int
    message: str


Message = Step | Expected | Planned | Done | Failed


def encode(message: Message) -> str:
    """The message as one line of JSON, without its end."""
    if isinstance(message, Step):
        content = asdict(message)
    elif isinstance(message, Expected):
        content = {"stage": "expected", **asdict(message)}
    elif isinstance(message, Planned):
        content = {"stage": "planned", "decisions": [asdict(decision) for decision in message.decisions]}
    elif isinstance(message, Done):
        names = {"out": message.out, "object": message.object_name}
        content = {"stage": "done", **{k: v for k, v in names.items() if v}, "report": message.report}
    else:
        content = {"stage": "error", "code": message.code, "message": message.message}
    return json.dumps(content, allow_nan=False)


def decode(line: str) -> Message | None:
    """The message in a line; None where it holds none."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or not isinstance(content.get("stage"), str):
        return None
    stage = content["stage"]
    if stage == "expected":
        return read_expected(content)
    if stage == "planned":
        return Planned(read_decisions(content.get("decisions")))
    if stage == "done":
        report = content.get("report")
        report = report if isinstance(report, dict) else {}
        return Done(report, _text(content.get("out")), _text(content.get("object")))
    if stage == "error":
        code = read_number(content.get("code"))
        return Failed(1 if code is None else int(code), _text(content.get("message")))
    numbers = {name: read_number(content.get(name)) for name in ("step", "total", "loss", "seconds_left")}
    return Step(
        stage, numbers["step"] or 0.0, numbers["total"] or 0.0, numbers["loss"], numbers["seconds_left"]
    )


def read_expected(content: Any) -> Expected | None:
    """What a run was expected to take, from a message or from `expected` in a report; None where that is not said."""
    if not isinstance(content, dict) or (total := read_number(content.get("total_seconds"))) is None:
        return None
    stages = content.get("seconds")
    seconds = (
        {str(k): float(v) for k, v in stages.items() if read_number(v) is not None}
        if isinstance(stages, dict)
        else {}
    )
    reached = content.get("albedo_psnr_after_gain")
    values = (
        [read_number(reached.get(name)) for name in ("mean", "lowest", "highest")]
        if isinstance(reached, dict)
        else []
    )
    known = [value for value in values if value is not None]
    return Expected(seconds, total, Quality(*known) if len(known) == 3 else None)


def read_decisions(lines: Any) -> tuple[Decision, ...]:
    """The lines of a plan, from a message or from `plan` in a report; what is none is left out."""
    found = []
    for line in lines if isinstance(lines, list) else ():
        if isinstance(line, dict) and all(
            isinstance(line.get(name), str) for name in ("what", "choice", "reason")
        ):
            found.append(Decision(line["what"], line["choice"], line["reason"], _text(line.get("costs"))))
    return tuple(found)


def read_number(value: Any) -> float | None:
    """A finite number, or None for anything else."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number and math.isfinite(value) else None


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""
