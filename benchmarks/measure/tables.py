"""The GigaLit results as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from measure.machine import sentence
from measure.score import AFTER_GAIN

#: What the paper reports: albedo PSNR of the raw prior and of lifting alone, and how far its full model is ahead
#: of the raw prior in albedo and in relighting (section 4, GigaLit).
PAPER = {
    "DiffusionRenderer": {"raw": 23.36, "lifted": 25.69, "albedo lead": 2.63, "relit lead": 6.13},
    "RGB-X": {"raw": 21.65, "lifted": 25.32, "albedo lead": 3.85, "relit lead": 7.15},
}
METRICS = ("PSNR", "SSIM", "LPIPS", "FLIP")


@dataclass(frozen=True)
class Row:
    """One method on one object: its scores in albedo and relighting, and the seconds to its texture."""

    object: str
    method: str
    prior: str
    seconds: float
    albedo: dict[str, float]
    relit: dict[str, float]
    commit: str = ""


def markdown(rows: Sequence[Row], facts: dict[str, object]) -> str:
    """Mean table, per-object tables, and the lead over the raw prior, with what they were made with."""
    names = sorted({row.object for row in rows})
    parts = [
        f"Mean over {len(names)} objects; each cell is the picture as it is / after one gain per channel. "
        "PSNR in dB and SSIM: more is better; LPIPS and FLIP: less is better. Foreground only.",
        "**Priors are stand-ins**: made from the true albedo by blur, shading leak, tint and invented detail, partly "
        "shared by all views, with strengths set to the paper's figures for the network they are named after.",
        mean_table(rows),
        "Albedo PSNR per object:",
        object_table(rows, names, "albedo"),
        "Relighting PSNR per object:",
        object_table(rows, names, "relit"),
    ]
    leads = lead_table(rows)
    if leads:
        parts += ["Ahead of the raw prior, in dB of PSNR, mean over the objects:", leads]
    commits = sorted({row.commit for row in rows} - {str(facts["commit"])})
    others = [f"*Commit {commit}: {', '.join(_rows_of(rows, commit))}.*" for commit in commits]
    return "\n\n".join([*parts, f"*{sentence(facts)}*", *others])


def _rows_of(rows: Sequence[Row], commit: str) -> list[str]:
    """The names of a commit's rows."""
    names = dict.fromkeys((row.method, row.prior) for row in rows if row.commit == commit)
    return [method if prior == "none" else f"{method} [{prior}]" for method, prior in names]


def mean_table(rows: Sequence[Row]) -> str:
    head = ["prior", "method"]
    head += [f"{side} {metric}" for side in ("albedo", "relit") for metric in METRICS] + ["seconds"]
    body = []
    for prior, method, own in grouped(rows):
        cells = [_both([row.albedo for row in own], metric) for metric in METRICS]
        cells += [_both([row.relit for row in own], metric) for metric in METRICS]
        body.append([_stand_in(prior), method, *cells, _seconds(own)])
    return _table(head, body, left=2)


def object_table(rows: Sequence[Row], names: Sequence[str], side: str) -> str:
    body = []
    for prior, method, own in grouped(rows):
        by_name = {row.object: getattr(row, side) for row in own}
        body.append([_stand_in(prior), method, *(_both([by_name[name]], "PSNR") for name in names)])
    return _table(["prior", "method", *names], body, left=2)


def lead_table(rows: Sequence[Row]) -> str:
    """Each row with a stand-in prior against that raw prior, beside the lead of the paper's full model."""
    means = {
        (prior, method): [
            np.mean([getattr(row, side)["PSNR"] for row in own]) for side in ("albedo", "relit")
        ]
        for prior, method, own in grouped(rows)
    }
    body = []
    for (prior, method), (albedo, relit) in means.items():
        if prior in PAPER and method != "raw prior" and (prior, "raw prior") in means:
            raw_albedo, raw_relit = means[prior, "raw prior"]
            paper = PAPER[prior]
            cells = [f"{albedo - raw_albedo:+.2f}", f"{paper['albedo lead']:+.2f}"]
            cells += [f"{relit - raw_relit:+.2f}", f"{paper['relit lead']:+.2f}"]
            body.append([_stand_in(prior), method, *cells])
    head = ["prior", "method", "albedo", "paper's full, albedo", "relit", "paper's full, relit"]
    return _table(head, body, left=2) if body else ""


def grouped(rows: Sequence[Row]) -> Iterable[tuple[str, str, list[Row]]]:
    """(prior, method, its rows over the objects), in the order of first appearance."""
    for prior, method in dict.fromkeys((row.prior, row.method) for row in rows):
        yield prior, method, [row for row in rows if (row.prior, row.method) == (prior, method)]


def _both(scores: Sequence[dict[str, float]], metric: str) -> str:
    digits = 2 if metric == "PSNR" else 3
    pair = (np.mean([each[name] for each in scores]) for name in (metric, metric + AFTER_GAIN))
    return " / ".join(f"{value:.{digits}f}" for value in pair)


def _seconds(rows: Sequence[Row]) -> str:
    seconds = float(np.mean([row.seconds for row in rows]))
    return f"{seconds:.0f}" if seconds >= 1.0 else ""


def _stand_in(prior: str) -> str:
    return prior if prior == "none" else f"{prior} stand-in"


def _table(head: Sequence[str], body: Sequence[Sequence[str]], left: int) -> str:
    rule = ["---"] * left + ["---:"] * (len(head) - left)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *body))
