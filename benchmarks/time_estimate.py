"""How right the expected seconds are: `python3 dev.py bench time_estimate SCENE... [--irradiance field] [--preset P...] [--json]`.

Recovers each scene under each preset and compares report.json's `expected` with what it then took, stage by stage and from
start to end of the command. Run it on a machine that does nothing else: an expectation is made from one second of it.
Prints a Markdown table and the worst error of a total.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from measure.command import ROOT, dante_w


@dataclass(frozen=True)
class Row:
    """One run: (expected, actual) seconds of each stage, and of the whole command."""

    scene: str
    preset: str
    stages: dict[str, tuple[float, float]]
    total: tuple[float, float]


def main() -> None:
    options = parse()
    rows = []
    for _ in range(options.repeat):
        for scene in options.scenes:
            for preset in options.preset:
                out = options.out / scene.name / preset
                arguments = ["recover", str(scene), "--irradiance", options.irradiance, "--preset", preset]
                if (scene / "mesh.obj").is_file():  # GigaLit's folders do not name their mesh
                    arguments += ["--mesh", str(scene / "mesh.obj")]
                if options.texture_size:
                    arguments += ["--texture-size", options.texture_size]
                report, seconds = dante_w(arguments, out)
                rows.append(compare(scene.name, preset, report, seconds))
    print(table(rows))
    worst = max((abs(error(*row.total)) for row in rows), default=0.0)
    print(f"\nworst error of a total: {worst:.0f}%")
    if options.json:
        print(json.dumps({"worst_percent": worst, "rows": [asdict(row) for row in rows]}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--irradiance", default="traced", choices=("traced", "field"))
    parser.add_argument("--preset", nargs="+", default=["draft", "standard"])
    parser.add_argument("--texture-size", help="instead of the presets' own")
    parser.add_argument("--repeat", type=int, default=1, help="runs of each")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "time_estimate", help="for the textures")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def compare(scene: str, preset: str, report: dict[str, Any], seconds: float) -> Row:
    """A run's row from its report and the seconds its command took."""
    expected, actual = report["expected"]["seconds"], report["seconds"]
    names = [*expected, *(name for name in actual if name not in expected)]
    stages = {name: (expected.get(name, 0.0), actual.get(name, 0.0)) for name in names}
    return Row(scene, preset, stages, (report["expected"]["total_seconds"], seconds))


def error(expected: float, actual: float) -> float:
    """By how many percent of the actual the expected is off.

    >>> error(13.0, 10.0)
    30.0
    """
    return 100.0 * (expected - actual) / max(actual, 1e-9)


def table(rows: list[Row]) -> str:
    """Expected / actual seconds and the error, per run and stage, as a Markdown table."""
    names = list(dict.fromkeys(name for row in rows for name in row.stages))
    heads = ["scene", "preset", "total", *names]
    lines = [f"| {' | '.join(heads)} |", f"|---|---|{'---:|' * (len(heads) - 2)}"]
    for row in rows:
        pairs = [row.total, *(row.stages.get(name) for name in names)]
        lines.append(f"| {row.scene} | {row.preset} | {' | '.join(map(cell, pairs))} |")
    return "\n".join(lines)


def cell(pair: tuple[float, float] | None) -> str:
    return "" if pair is None else f"{pair[0]:.1f} / {pair[1]:.1f} ({error(*pair):+.0f}%)"


if __name__ == "__main__":
    main()
