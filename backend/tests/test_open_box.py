"""The whole command on a concave scene: walls hide the sky from each other and colour each other's light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dante_w.commands.cli import main
from dante_w.scene.images import read_texture
from open_box import EAST, WEST, albedo_at, make_open_box, texels

SIZE = 128
#: PSNR in dB of linear albedo. Found were 32.8; without bounced light 26.0, and without occlusion 17.8.
PROMISED = 30.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_open_box(tmp_path_factory.mktemp("open box") / "scene")


def recovered(scene: Path, out: Path, *options: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Recovered albedo (N, 3) after one gain per channel, true albedo (N, 3) and side (N,) of texels away from edges of checks."""
    command = ["recover", str(scene), "--out", str(out), "--preset", "draft", "--texture-size", str(SIZE)]
    assert main([*command, "--json", *options]) == 0
    used, side, place = texels(SIZE)
    inside = np.abs(place * 4.0 - np.rint(place * 4.0)).min(axis=1) > 0.12
    used, side, place = used[inside], side[inside], place[inside]
    found, truth = read_texture(out / "albedo.png").reshape(-1, 3)[used], albedo_at(side, place)
    return found * ((found * truth).sum(axis=0) / (found**2).sum(axis=0)), truth, side


def psnr(found: np.ndarray, truth: np.ndarray) -> float:
    return float(-10.0 * np.log10(np.square(found - truth).mean()))


def tinge(found: np.ndarray, truth: np.ndarray, side: np.ndarray) -> float:
    """Error of colour divided by brightness on the grey sides, which nine tenths of the texels stay below."""
    grey = (side != WEST) & (side != EAST)
    apart = [each[grey] / each[grey].mean(axis=1, keepdims=True) for each in (found, truth)]
    return float(np.quantile(np.abs(apart[0] - apart[1]).max(axis=1), 0.9))


def test_occlusion_and_bounced_light_leave_the_albedo(scene, tmp_path):
    found, truth, side = recovered(scene, tmp_path / "out")
    assert psnr(found, truth) > PROMISED
    assert tinge(found, truth, side) < 0.05


def test_without_bounced_light_walls_tinge_each_other(scene, tmp_path):
    """So the test above can fail."""
    found, truth, side = recovered(scene, tmp_path / "out", "--leave-out", "bounce")
    assert psnr(found, truth) < PROMISED - 2.0
    assert tinge(found, truth, side) > 0.06
