"""The extremes, and what is promised there: `python3 dev.py bench stability [--only FAMILY...] [--out FILE] [--json]`.

A small generated scene goes through every extreme by the product's own command, with traced light and with the paper's model, and
is compared with a float64 reference or with the scene as it was (`benchmarks/extremes/`, one family a file). Prints one Markdown
table a family; --out writes them as a page. Exits with 1 if a row does not hold.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from extremes.row import Row
from measure.machine import provenance, sentence

#: Modules of `extremes/`, each with `rows(progress)`.
FAMILIES = ("geometry", "radiance", "encodings", "fitting", "uvs", "sizes", "faults")
HEAD = """# Stability

What is promised at the extremes, and what was measured there. Made by `python3 dev.py bench stability --out FILE`.

The scene: hills of 392 triangles, a known albedo, eight float photos of 96 x 96 pixels under three lights, texture 128 x 128. PSNR is of
sRGB albedo. "traced" is the default model with 64 directions of light, "field" the paper's with few and small grids and 300 steps. In every
run all losses, gradients, lights and textures are looked at; one that is not finite fails its row."""


def main() -> int:
    options = parse()
    rows = list(measured(options.only))
    facts = provenance()
    failed = sum(not row.holds for row in rows)
    page = markdown(rows, facts)
    print(page)
    if options.out is not None:
        options.out.write_text(f"{HEAD}\n\n{page}\n", encoding="utf-8")
    if options.json:
        print(json.dumps({"measured": facts, "rows": [row._asdict() for row in rows], "failed": failed}))
    return 1 if failed else 0


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--only", nargs="+", choices=FAMILIES, default=list(FAMILIES), help="these families alone"
    )
    parser.add_argument("--out", type=Path, help="write the page here")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def measured(families: Iterable[str]) -> Iterator[Row]:
    """All rows of the families. One that cannot be measured is a row that does not hold."""

    def progress(name: str) -> None:
        print(f"   {name}", file=sys.stderr, flush=True)

    for family in families:
        print(f"== {family}", file=sys.stderr, flush=True)
        try:
            for row in importlib.import_module(f"extremes.{family}").rows(progress):
                print(
                    f"   {'holds' if row.holds else 'FAILS'}: {row.name}: {row.measured}",
                    file=sys.stderr,
                    flush=True,
                )
                yield row
        except Exception as error:
            yield Row(
                "the rest of this family", family, f"{type(error).__name__}: {error}", "a measurement", False
            )


def markdown(rows: list[Row], facts: dict[str, object]) -> str:
    """How many hold, a table for each family, and what they were measured with."""
    failed = [row.name for row in rows if not row.holds]
    found = f"{len(rows) - len(failed)} of {len(rows)} rows hold." + (
        f" Not: {'; '.join(failed)}." if failed else ""
    )
    parts = [found]
    for family in dict.fromkeys(row.family for row in rows):
        lines = ["| | promised | measured | holds | |", "|---|---|---|---|---|"]
        for row in (row for row in rows if row.family == family):
            cells = row.name, row.bound, row.measured, "yes" if row.holds else "**no**", row.note
            lines.append(f"| {' | '.join(_cell(cell) for cell in cells)} |")
        parts += [f"## {family[0].upper()}{family[1:]}", "\n".join(lines)]
    return "\n\n".join([*parts, sentence(facts)])


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


if __name__ == "__main__":
    sys.exit(main())
