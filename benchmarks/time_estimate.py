"""How right the expected seconds are, and the table that they come from:
`python3 dev.py bench time_estimate SCENE... [--model traced field average] [--preset P...] [--fit] [--json]`.

Makes a texture of each scene under each preset and compares report.json's `expected` with what it then took, stage by stage and
from start to end of the command. Prints a Markdown table and the worst error of a total.

With --fit, the seconds per unit of work are fitted to all reports under --out, also those of former calls, and written to
backend/dante_w/estimate/seconds.json. Printed is then how far off totals would be: for runs of each scene, by a table fitted to the
others. Run it on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dante_w.estimate.seconds import TABLE, Probe, Work, predict
from measure.command import ROOT, dante_w
from measure.fit_seconds import fit, model_of


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
            for model in options.model:
                for preset in options.preset if model != "average" else ("",):
                    number = len(list(options.out.glob(f"{scene.name}/*")))
                    out = options.out / scene.name / f"{number}-{model}-{preset}".strip("-")
                    report, seconds = dante_w(arguments(scene, model, preset, options.texture_size), out)
                    if model != "average":
                        rows.append(compare(scene.name, f"{model} {preset}", report, seconds))
    print(table(rows))
    worst = max((abs(error(*row.total)) for row in rows), default=0.0)
    print(f"\nworst error of a total: {worst:.0f}%")
    if options.json:
        print(json.dumps({"worst_percent": worst, "rows": [asdict(row) for row in rows]}))
    if options.fit:
        files = sorted(options.out.glob("*/*/report.json"))
        reports = [(file.parts[-3], json.loads(file.read_text(encoding="utf-8"))) for file in files]
        print(left_out(reports))
        text = json.dumps(fit([report for _, report in reports]), indent=1)
        TABLE.write_text(text + "\n", encoding="utf-8")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="*", metavar="SCENE")
    parser.add_argument("--model", nargs="+", default=["traced"], choices=("traced", "field", "average"))
    parser.add_argument("--preset", nargs="+", default=["draft", "standard"])
    parser.add_argument("--texture-size", help="instead of the presets' own")
    parser.add_argument("--repeat", type=int, default=1, help="runs of each")
    parser.add_argument("--fit", action="store_true", help="write the table of seconds per unit of work")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "time_estimate", help="for the textures")
    parser.add_argument("--json", action="store_true", help="one line is a JSON object")
    return parser.parse_args()


def arguments(scene: Path, model: str, preset: str, texture_size: str | None) -> list[str]:
    """The command that makes a texture of a scene, without its --out."""
    words = ["average"] if model == "average" else ["recover", "--irradiance", model, "--preset", preset]
    words.insert(1, str(scene))
    if (scene / "mesh.obj").is_file():  # GigaLit's folders do not name their mesh
        words += ["--mesh", str(scene / "mesh.obj")]
    return [*words, "--texture-size", texture_size] if texture_size else words


def left_out(reports: list[tuple[str, dict[str, Any]]]) -> str:
    """For each scene and model, the error of the seconds of stages that a table predicts which was fitted to the other scenes."""
    lines = ["| scene | model | predicted / actual |", "|---|---|---:|"]
    for name in sorted({scene for scene, _ in reports}):
        others = fit([report for scene, report in reports if scene != name])
        for scene, report in reports:
            if scene == name and model_of(report) in others["seconds_per_unit"]:
                work, probe = Work(**report["work"]), Probe(**report["probe"])
                expected = predict(work, model_of(report), probe, table=others)
                pair = sum(expected.values()), sum(report["seconds"][stage] for stage in expected)
                lines.append(f"| {name} | {model_of(report)} | {cell(pair)} |")
    return "\n".join(lines)


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
