"""The result folder as its reader sees it: names of its files, and what of `report.json` is shown to people.

The report has more keys than are read here, see docs/cli.md. What is missing or of another kind is left out, so
that reports of older and newer versions can be read.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .protocol import Decision, Expected, read_decisions, read_expected, read_number

#: Written last: a folder without it is not a whole result.
REPORT = "report.json"
COVERAGE = "coverage.png"
#: The mesh with its new UVs, where they were asked for.
MESH = "mesh.obj"


def albedo_file(file_format: str) -> str:
    """Name of the albedo texture in a format of the vocabulary."""
    return "albedo.exr" if file_format == "exr" else "albedo.png"


@dataclass(frozen=True)
class Summary:
    """What a report says of a result.

    Attributes:
        held_out_psnr: mean PSNR in dB of sRGB at which the held-out photos are re-rendered.
        coverage: part of the mesh's texels that a photo saw, in [0, 1].
        texture_size: texels along a side.
        seconds: of the whole run.
        expected: what was expected of it before.
        plan: what was modelled, and why.
        file_format: of the albedo texture.
        unwrapped: whether the result has new UVs.
    """

    held_out_psnr: float | None
    coverage: float | None
    texture_size: int | None
    seconds: float | None
    expected: Expected | None
    plan: tuple[Decision, ...]
    file_format: str
    unwrapped: bool


def read_report(folder: Path) -> dict[str, Any]:
    """The report in a result folder.

    Raises:
        OSError, ValueError: there is none, so the folder is not a whole result.
    """
    content = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise ValueError(f"{folder / REPORT} is not a report")
    return content


def summary(report: dict[str, Any]) -> Summary:
    """What a report says, in this version's words."""
    settings = report.get("settings")
    if not isinstance(settings, dict):
        settings = {}
    stages = report.get("seconds")
    seconds = [read_number(value) for value in stages.values()] if isinstance(stages, dict) else []
    size = report.get("texture_size")
    return Summary(
        held_out_psnr=read_number(report.get("held_out_psnr")),
        coverage=read_number(report.get("coverage")),
        texture_size=size if isinstance(size, int) else None,
        seconds=sum(value for value in seconds if value is not None) if seconds else None,
        expected=read_expected(report.get("expected")),
        plan=read_decisions(report.get("plan")),
        file_format=str(settings.get("format", "png")),
        unwrapped=bool(settings.get("unwrap")),
    )
