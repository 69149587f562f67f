"""Known colours given to the command."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from command_runs import SIZE, accuracy, run
from dante_w.commands.cli import main
from dante_w.core.color import srgb_from_linear_array
from dante_w.scene.images import read_texture
from square_scene import SQUARE, albedo_at


def colour_at(folder: Path, u: float, v: float) -> np.ndarray:
    """Median linear albedo (3,) around a texture coordinate."""
    row, column = int((1.0 - v) * SIZE), int(u * SIZE)
    return np.median(
        read_texture(folder / "albedo.png")[row - 2 : row + 2, column - 2 : column + 2], axis=(0, 1)
    )


@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_known_colours_are_met(recovered, irradiance):
    """The spots lie in the middle of checks: one reddish, one bluish."""
    truth = albedo_at(np.array([0.625, 0.375]))
    red, green, blue = np.rint(255 * srgb_from_linear_array(truth)).astype(int)
    known = ("--known", "0.625", "0.375", f"#{red:02x}{green:02x}{blue:02X}")
    result = recovered("--irradiance", irradiance, *known)
    np.testing.assert_allclose(colour_at(result.folder, 0.625, 0.375), truth, rtol=0.05)
    report = result.report
    (said,) = report["settings"]["known"]
    assert (said["u"], said["v"]) == (0.625, 0.375)
    assert accuracy(result.folder) > 22.0
    assert len(report["albedo_gain"]) == 3 and max(abs(gain - 1.0) for gain in report["albedo_gain"]) > 0.05


def test_a_spot_known_to_be_grey_becomes_grey(recovered):
    result = recovered("--known", "0.375", "0.375", "grey")
    found = colour_at(result.folder, 0.375, 0.375)
    np.testing.assert_allclose(found, found.mean(), rtol=0.05)
    assert np.prod(result.report["albedo_gain"]) == pytest.approx(1.0, abs=1e-3)


def test_known_colours_that_say_nothing_are_refused(scene, tmp_path):
    (scene / "mesh.obj").write_text(SQUARE.replace("vt 1 ", "vt 0.5 "))  # half of the texture is empty
    unseen = ("--known", "0.9", "0.5", "grey")
    for extra, message in ((unseen, "No photo saw .* 0.9 0.5"), ((*unseen, "--unwrap"), "--unwrap")):
        code, events = run("recover", scene, "--out", tmp_path / "out", *extra)
        assert code == 2 and re.search(message, events[-1]["message"])
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [("0.5", "1.5", "grey"), ("0.5", "0.5", "red"), ("0.5", "0.5", "#00FFFF")])
def test_known_colours_that_make_no_sense_are_one_sentence(square, tmp_path, capsys, monkeypatch, words):
    arguments = ["recover", str(square), "--out", str(tmp_path / "out"), "--known", *words, "--json"]
    monkeypatch.setattr(sys, "argv", ["dante-w", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    (line,) = capsys.readouterr().out.splitlines()
    said = json.loads(line)
    assert (said["stage"], said["code"]) == ("error", 2)
    assert " ".join(words) in said["message"] and "\n" not in said["message"]
