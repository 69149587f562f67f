"""Everything that may go wrong outside of the numbers, really provoked: see the files that this one calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from extremes import broken_files, fuzz, kills, shortage, side_by_side
from extremes.provoke import failed, stand
from extremes.row import Row


def rows(progress: Callable[[str], None], inputs: int = fuzz.INPUTS) -> Iterator[Row]:
    """The rows of all faults; `inputs` for each reader that is fuzzed."""
    try:
        with stand() as place:
            for family in (kills, side_by_side, shortage, broken_files):
                yield from family.rows(place, progress)
    except (OSError, RuntimeError) as error:
        yield failed("the scene that faults are tried on", error)
    yield from fuzz.rows(progress, inputs)
