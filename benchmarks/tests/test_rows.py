"""The rows of the table: which model makes which, and that no two share a file."""

from __future__ import annotations

import json
from dataclasses import asdict

import gigalit
from dante_w.commands import cli
from measure.tables import Row
from methods.rows import NO_PRIOR, methods

ROWS = list(methods(["draft", "standard"], [NO_PRIOR, "RGB-X"]))


def test_papers_rows_are_the_papers_model_and_traced_light_is_the_default():
    for row in ROWS:
        if row.tool != "dante-w" or row.arguments[0] != "recover":
            continue
        given = cli.parse([row.arguments[0], "scene", "--out", "out", *row.arguments[1:]]).options
        assert given.irradiance == (None if "traced" in row.name else "field"), row.name
        assert not (given.no_photometric or given.equal_bands) or "traced" not in row.name
        named = row.name.rpartition(", ")[2]
        assert given.preset == (named if named in ("draft", "high") else "standard")


def test_traced_light_has_a_row_with_every_prior():
    for prior in (NO_PRIOR, "RGB-X"):
        assert [row.name for row in ROWS if "traced" in row.name and row.prior == prior] == [
            "ours, traced light",
            "ours, traced light, draft",
            "ours, traced light, high",
        ]


def test_no_two_rows_share_a_file_and_what_is_shown_exists():
    assert len({row.slug for row in ROWS}) == len(ROWS)
    assert set(gigalit.SHOWN) <= {row.name for row in ROWS}


def test_rows_made_again_take_the_place_of_their_namesakes(tmp_path):
    def row(method: str, prior: str, seconds: float, commit: str) -> Row:
        return Row("cup", method, prior, seconds, {"PSNR": 20.0}, {"PSNR": 21.0}, commit)

    file = tmp_path / "gigalit.json"
    new = [row("ours, traced light", "RGB-X", 2.0, "new"), row("ours, traced light", NO_PRIOR, 3.0, "new")]
    assert gigalit.among(new, file) == new[::-1]  # in the table's order
    old = [row("photos averaged", NO_PRIOR, 1.0, "old"), row("ours, traced light", "RGB-X", 9.0, "old")]
    file.write_text(json.dumps({"rows": [asdict(each) for each in old]}))
    assert gigalit.among(new, file) == [old[0], *new[::-1]]
