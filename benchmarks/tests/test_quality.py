"""What a run says of its presets is what the published benchmark has."""

import json
from dataclasses import replace

import pytest
from dante_w.estimate.expectation import QUALITY
from gigalit import quality
from measure.command import ROOT
from measure.tables import Row

PUBLISHED = json.loads((ROOT / "docs/gigalit/gigalit.json").read_text(encoding="utf-8"))["rows"]


def test_the_product_says_what_the_benchmark_has():
    figures = quality([Row(**row) for row in PUBLISHED])
    assert figures == json.loads(QUALITY.read_text(encoding="utf-8"))
    assert set(figures["traced"]) == set(figures["field"]) == {"draft", "standard", "high"}


def test_rows_with_priors_and_ablations_do_not_count():
    row = Row("box", "ours, traced light", "none", 1.0, {"PSNR after gain": 30.04}, {}, "")
    others = [
        replace(row, object="apple", albedo={"PSNR after gain": 25.0}),
        replace(row, prior="RGB-X", albedo={"PSNR after gain": 99.0}),
        replace(row, method="ours, equal bands", albedo={"PSNR after gain": 99.0}),
        replace(row, method="photos averaged", albedo={"PSNR after gain": 1.0}),
    ]
    figures = quality([row, *others])
    assert figures["traced"]["standard"] == pytest.approx({"mean": 27.5, "lowest": 25.0, "highest": 30.0})
    assert (list(figures["traced"]), figures["field"]) == (["standard"], {})
