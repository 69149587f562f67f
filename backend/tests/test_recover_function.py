"""`recover`: the command's work as a function, with settings of the caller's."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from dante_w.commands.recover import recover
from dante_w.contract.errors import BadInput
from dante_w.options import RecoverOptions
from small_settings import small_preset


def test_a_result_like_the_commands(scene, tmp_path):
    out = tmp_path / "out"
    preset = small_preset(32, name="draft")
    settings = replace(preset, traced=replace(preset.traced, directions=16))
    report = recover(RecoverOptions(scene, out, preset="draft", texture_size=32), settings)
    assert report == json.loads((out / "report.json").read_text())
    assert sorted(path.name for path in out.iterdir()) == ["albedo.png", "coverage.png", "report.json"]
    assert report["texture_size"] == 32 and report["settings"]["preset"] == "draft"


def test_a_failure_loses_nothing(scene, tmp_path):
    out = tmp_path / "out"
    (scene / "1.png").unlink()
    with pytest.raises(BadInput, match=r"1\.png"):
        recover(RecoverOptions(scene, out))
    assert not out.exists() or not list(out.iterdir())
    with pytest.raises(BadInput, match="out"):
        recover(RecoverOptions(scene))
    with pytest.raises(BadInput, match="paper's model"):
        recover(RecoverOptions(scene, out, preset="paper"))
