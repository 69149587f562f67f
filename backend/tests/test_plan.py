"""The plan's sizes: the texture follows the photos' pixels, memory what will be held; what the user says stands."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from conftest import cast
from dante_w.commands import recover_traced, stages
from dante_w.commands.cli import main
from dante_w.commands.plan_report import LEAST_SIDE, texture_side
from dante_w.contract.protocol import YOU_CHOSE
from dante_w.contract.scene_folder import Camera, Frame
from dante_w.estimate import memory
from dante_w.presets import PRESETS
from dante_w.rays import footprint
from dante_w.rays.footprint import GLANCE, glance
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.load import load_scene
from dante_w.scene.mesh import read_mesh
from small_settings import TRACED
from square_scene import CAMERA, SQUARE, make_scene, pose

SMALL = dataclasses.replace(PRESETS["standard"], traced=TRACED)
MOST = 4096


@pytest.fixture
def square(tmp_path):
    (tmp_path / "mesh.obj").write_text(SQUARE)
    return read_mesh(tmp_path / "mesh.obj")


def photos(resolution: float, *heights: float) -> list[Frame]:
    """Straight down on the unit square from heights, with that many pixels a unit of height and length."""
    side = round(1.4 * resolution)
    camera = Camera("PINHOLE", side, side, (resolution, resolution, side / 2, side / 2))
    return [Frame(None, camera, pose(0.5, 0.5, height)) for height in heights]


def side_of(found: footprint.Glance, **more) -> int:
    return texture_side(
        found.footprint, **{"most": MOST, "chosen": None, "texel": 1, "free": 1 << 40} | more
    )[0]


@pytest.mark.parametrize("resolution", [300, 450, 700])
def test_twice_the_photos_resolution_twice_the_texture_up_to_the_most(square, resolution):
    first = side_of(glance(Scene3D.build(square), photos(resolution, 1.0)))
    assert resolution <= first < 2 * resolution * 1.05
    for times in (2, 4, 8, 16, 32):
        assert side_of(glance(Scene3D.build(square), photos(times * resolution, 1.0))) == min(
            times * first, MOST
        )


def test_half_the_texture_for_charts_half_as_long(square):
    small = dataclasses.replace(square, uvs=0.5 * square.uvs)
    assert side_of(glance(Scene3D.build(small), photos(900, 1.0))) == 2 * side_of(
        glance(Scene3D.build(square), photos(900, 1.0))
    )


def test_the_sharper_photos_decide(square):
    """One in two is four times as far; of the sharper quarter of pixels all are the near ones'."""
    alone = side_of(glance(Scene3D.build(square), photos(900, 1.0)))
    assert side_of(glance(Scene3D.build(square), photos(900, 1.0, 1.3))) == alone
    assert side_of(glance(Scene3D.build(square), photos(900, 4.0))) == max(alone // 4, LEAST_SIDE)


def test_a_few_pixels_tell_what_all_of_them_do(tmp_path):
    scene, mesh = load_scene(make_scene(tmp_path / "s"), None, None, None)
    cache = cast(mesh, scene.frames, tmp_path)
    found = glance(Scene3D.build(mesh), scene.frames)
    assert footprint.sharp_footprint(found.footprint) == pytest.approx(
        footprint.sharp_footprint(cache.footprint), rel=0.02
    )
    assert found.share * CAMERA.width * CAMERA.height * 8 == pytest.approx(len(cache), rel=0.03)


def test_a_mesh_to_be_unwrapped_is_taken_to_fill_the_texture_evenly(square):
    charts = dataclasses.replace(square, uvs=GLANCE.filled**0.5 * square.uvs)
    bare = dataclasses.replace(square, uvs=None)
    frames = photos(900, 1.0, 1.5)
    np.testing.assert_allclose(
        glance(Scene3D.build(bare), frames).footprint,
        glance(Scene3D.build(charts), frames).footprint,
        rtol=1e-5,
    )


def test_bounds_and_reasons(square):
    found = glance(Scene3D.build(square), photos(900, 1.0))
    coarse = footprint.Glance(1e4 * found.footprint, 1.0)
    assert (side_of(found, most=512), side_of(coarse), side_of(coarse, most=64)) == (512, LEAST_SIDE, 64)
    assert "preset" in texture_side(found.footprint, 512, None, 1, 1 << 40)[1].reason
    side, said = texture_side(found.footprint, MOST, None, 40, 40 * 512**2)
    assert side == 512 and "memory" in said.reason
    side, said = texture_side(found.footprint, MOST, 777, 40, 0)
    assert (side, said.choice, said.reason) == (777, "777 x 777", YOU_CHOSE)
    assert side_of(footprint.Glance(np.zeros(0), 0.0)) == MOST


def planned(capsys, *arguments: str) -> tuple[dict, dict]:
    """The report of a plan, and its lines by what they decide."""
    small = None if "--preset" in arguments else SMALL
    assert main(["plan", *arguments, "--json"], settings=small) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])["report"]
    return report, {line["what"]: line for line in report["plan"]}


@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_the_users_size_wins(scene, capsys, irradiance):
    more = ("--irradiance", irradiance, "--preset", "draft")
    report, lines = planned(capsys, str(scene), *more)
    assert report["texture_size"] == LEAST_SIDE and lines["texture"]["choice"] == "256 x 256"
    report, lines = planned(capsys, str(scene), *more, "--texture-size", "100")
    assert report["texture_size"] == 100 and lines["texture"]["reason"] == YOU_CHOSE
    assert lines["light"]["reason"] == YOU_CHOSE
    assert f"{report['samples']:,} of {8 * 48 * 36:,}" in lines["samples"]["choice"]


def test_the_meshs_own_normals_are_taken_where_it_has_some(scene, capsys):
    assert planned(capsys, str(scene))[1]["normals"]["choice"].startswith("smooth")
    mesh = scene / "mesh.obj"
    faces = re.sub(r"(\d+/\d+)\S*", r"\1/1", "\n".join(re.findall("^f .*$", mesh.read_text(), re.M)))
    rest = re.sub("^f .*\n?", "", mesh.read_text(), flags=re.M)
    mesh.write_text(f"{rest}vn 0 0 1\n{faces}\n")
    assert planned(capsys, str(scene))[1]["normals"]["choice"] == "the mesh's own"


def test_draft_leaves_suns_out_unless_the_user_wants_them(scene, capsys):
    preset = (str(scene), "--preset", "draft")
    sun = planned(capsys, *preset)[1]["sun"]
    assert (sun["choice"], sun["reason"]) == ("none", "the preset draft leaves it out")
    sun = planned(capsys, *preset, "--model", "sun")[1]["sun"]
    assert (sun["choice"], sun["reason"]) == ("looked for", YOU_CHOSE)


@pytest.mark.parametrize("command", ["recover", "plan"])
def test_parts_of_traced_light_are_refused_beside_the_field(scene, tmp_path, capsys, command):
    out = ["--out", str(tmp_path / "out")] if command == "recover" else []
    for words in (["--model", "groups"], ["--leave-out", "gloss"]):
        assert main([command, str(scene), "--irradiance", "field", *words, *out, "--json"]) == 2
        last = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert re.search("--model and --leave-out .*traced", last["message"]) and "\n" not in last["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("irradiance", ["traced", pytest.param("field", marks=pytest.mark.slow)])
def test_memory_is_foretold(scene, tmp_path, irradiance):
    """Within a factor of 1.5 in a process of its own, whose peak is the run's."""
    options = ["--irradiance", irradiance, "--preset", "draft", "--texture-size", "2048", "--json"]
    command = [
        sys.executable,
        "-m",
        "dante_w",
        "recover",
        str(scene),
        "--out",
        str(tmp_path / "out"),
        *options,
    ]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    report = json.loads(done.stdout.splitlines()[-1])["report"]
    (line,) = (line for line in report["plan"] if line["what"] == "memory")
    foretold = 1e9 * float(re.match(r"about ([0-9.]+) GB of ", line["choice"])[1])
    assert report["peak_memory_bytes"] / 1.5 < foretold < 1.5 * report["peak_memory_bytes"]


def test_a_machine_too_small_takes_a_smaller_texture_and_says_so(tmp_path, capsys, monkeypatch):
    sharp = make_scene(tmp_path / "s", photos=3)
    close = footprint.Glance(np.full(100, 1.0 / 2000.0), 0.5)
    monkeypatch.setattr(stages, "glance", lambda scene3d, frames: close)
    assert planned(capsys, str(sharp))[0]["texture_size"] == 2048
    assert planned(capsys, str(sharp), "--preset", "high")[0]["texture_size"] == 2048
    monkeypatch.setattr(stages, "room", lambda: memory.resident() + memory.AVERAGED * 1500**2)
    report, lines = planned(capsys, str(sharp))
    assert report["texture_size"] == 1024 and "memory" in lines["texture"]["reason"]
    monkeypatch.setattr(recover_traced, "room", lambda: 1)
    assert "smaller" in planned(capsys, str(sharp))[1]["memory"]["reason"]
