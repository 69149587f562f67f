"""Two runs into one result folder: the second is refused, whoever it is, and the first ends as if it had been alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from extremes.provoke import MODELS, SIZE, Stand, ended, family, run, started, tried, wait_for
from extremes.row import Row

#: When the second one comes, in the first one's stages.
MOMENTS = {"traced": "transfer", "field": "optimise"}


def rows(place: Stand, progress: Callable[[str], None]) -> Iterator[Row]:
    for model, stage in MOMENTS.items():
        name = f"a second run into the same folder in stage {stage}, {model}"
        progress(name)
        yield tried(name, partial(_second, place, name, model, stage))


def _second(place: Stand, name: str, model: str, stage: str) -> Row:
    def arguments(out: Path) -> list[str | Path]:
        return ["recover", place.scene, "--out", out, "--preset", "draft", *SIZE, *MODELS[model]]

    alone = place.folder / f"alone-{model}"
    assert run(*arguments(alone)).code == 0
    out = place.fresh()
    first = started(*arguments(out))
    assert wait_for(first, stage), "it ended before"
    members = family(first)
    for each in members:  # else so small a scene is done before the second one has begun
        each.suspend()
    try:
        second = run("average", place.scene, "--out", out, *SIZE)
        former, _ = place.left()
    finally:
        for each in members:
            each.resume()
    said = first.stdout.read() if first.stdout else ""
    found = ended(first.wait(), said)
    same = all(
        (out / own).read_bytes() == (alone / own).read_bytes() for own in ("albedo.png", "coverage.png")
    )
    _, left = place.left()
    told = f"second exit {second.code}, former result {'intact' if former else 'CHANGED'} after it; first exit {found.code}, "
    told += f"{'same bytes as alone' if same else 'OTHER BYTES'}, {', '.join(left) or 'nothing'} left"
    good = (
        second.code == 2
        and f"process {members[-1].pid}" in second.sentence
        and former
        and found.code == 0
        and same
    )
    bound = "second exit 2, intact; first exit 0, same bytes as alone, nothing left"
    return Row(name, "faults", told, bound, good and not left, place.short(second.sentence))
