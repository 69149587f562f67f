"""One line of the stability table: an extreme, what is promised there, and what was measured."""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """`measured` and `bound` are short texts with their units, like "52.1 dB" and "at least 40 dB".

    Each module of this folder offers `rows(progress) -> Iterator[Row]`; it calls `progress(name)` before each row.
    A row whose measurement itself fails is yielded with `holds` False and the reason in `note`.
    """

    name: str
    family: str
    measured: str
    bound: str
    holds: bool
    note: str = ""
