"""Choosing objects, HDRIs and seeds; and one tiny scene through a real Blender."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import make_gigalit
import numpy as np
import pytest
from cycles.lights import Gloss, Lighting, find_hdris, hdris_named, relights_of
from make_gigalit import PRESETS, Progress, choose_hdris, find_things, seed_of
from measure.pictures import write

HDRIS = [f"sky_{letter}" for letter in "abcdefghijkl"]


@pytest.fixture
def skies(tmp_path: Path) -> Path:
    folder = tmp_path / "skies"
    folder.mkdir()
    for name in HDRIS:
        (folder / f"{name}.hdr").touch()
    return folder


def options(skies: Path, **given) -> argparse.Namespace:
    return argparse.Namespace(**{"hdris": skies, "seed": 0, "train_hdris": None, "held_out": None, **given})


def touch(folder: Path, *names: str) -> None:
    for name in names:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()


def test_objects_are_subfolders_and_files(tmp_path: Path):
    touch(tmp_path, "box/mesh.obj", "box/mesh.mtl", "box/albedo.png", "box/LICENCE.txt")
    touch(tmp_path, "cup.ply", "cup.jpg", "vase.glb", "readme.md")
    touch(tmp_path, "chair/chair.obj", "chair/chair_normal.png", "chair/chair_diff.jpg")
    things, faults = find_things(tmp_path)
    assert faults == []
    assert [(thing.name, thing.mesh.name, thing.texture and thing.texture.name) for thing in things] == [
        ("box", "mesh.obj", "albedo.png"),
        ("chair", "chair.obj", "chair_diff.jpg"),
        ("cup", "cup.ply", "cup.jpg"),
        ("vase", "vase.glb", None),
    ]


def test_what_cannot_be_used_is_named(tmp_path: Path):
    touch(tmp_path, "bare/mesh.obj", "two/a.obj", "two/b.obj", "empty/notes.txt")
    touch(tmp_path, "unclear/mesh.obj", "unclear/1.png", "unclear/2.png", "cup.obj", "cup.png", "cup/m.glb")
    things, faults = find_things(tmp_path)
    assert things == []
    assert sorted(fault.partition(":")[0] for fault in faults) == ["bare", "cup", "empty", "two", "unclear"]


def test_hdris_are_drawn_by_the_seed_and_kept_apart(skies: Path):
    for preset in PRESETS.values():
        training, held_out = choose_hdris(options(skies), preset)
        assert len(training) == preset.lightings
        assert len(held_out) == preset.held_out_count
        assert not set(training) & set(held_out)
        assert (training, held_out) == choose_hdris(options(skies), preset)
        assert (training, held_out) != choose_hdris(options(skies, seed=1), preset)


def test_hdris_may_be_named(skies: Path):
    training, held_out = choose_hdris(options(skies, held_out=["sky_a", "sky_b"]), PRESETS["small"])
    assert held_out == ["sky_a", "sky_b"]
    assert len(training) == 5 and not set(training) & set(held_out)
    with pytest.raises(SystemExit, match="sky_a"):
        choose_hdris(options(skies, held_out=["sky_a", "sky_b"], train_hdris=["sky_a"]), PRESETS["small"])
    with pytest.raises(SystemExit, match="too few"):
        choose_hdris(options(skies, train_hdris=HDRIS[:-1]), PRESETS["small"])


def test_an_hdri_is_found_by_how_its_name_begins(skies: Path):
    touch(skies, "market_1k.hdr", "sky_a_2k.exr")
    hdris = find_hdris(skies)
    found = hdris_named(["market", "sky_a"], hdris)
    assert {name: file.name for name, file in found.items()} == {
        "market": "market_1k.hdr",
        "sky_a": "sky_a.hdr",  # called just that, though another begins so
    }
    for unclear in ("sky", "sea"):
        with pytest.raises(SystemExit, match=unclear):
            hdris_named([unclear], hdris)


def test_seeds_differ_between_objects_and_fit_cycles():
    seeds = [seed_of(base, name) for base in (0, 1) for name in ("apple", "box", "bust")]
    assert len(set(seeds)) == 6
    assert all(0 <= seed < 2**30 for seed in seeds)
    assert seed_of(0, "apple") == seeds[0]


def test_the_paper_preset_has_the_papers_counts():
    paper = PRESETS["paper"]
    assert (paper.objects, paper.texture_size, paper.test) == (10, 4096, 250)
    assert (paper.lightings, paper.held_out_count) == (5, 5)


def test_progress_counts_what_is_there(tmp_path: Path):
    wanted = replace(PRESETS["small"], photos=3, test=2, relit_views=1)
    scenes = {"a": tmp_path / "a", "b": tmp_path / "b"}
    touch(tmp_path, "a/train/000.png", "a/train/001.partial.png")
    progress = Progress(scenes, wanted, held_out=2)  # 7 pictures each
    assert progress.line("a", "train/001.png") == "[2/14] a train/001.png"
    assert progress.line("a", "train/002.png").startswith("[3/14] a train/002.png, ")
    progress.finish("a")
    assert progress.line("b", "train/000.png").startswith("[8/14] ")


def test_relights_of_both_layouts(tmp_path: Path):
    def scene(truth: dict) -> Path:
        (tmp_path / "transforms_test.json").write_text('{"relit_gain": {"dusk": 2.0}}')
        (tmp_path / "truth.json").write_text(json.dumps(truth))
        return tmp_path

    bare = relights_of(scene({"lights": []}))
    assert bare.lights == [Lighting("dusk", 0.0)] and bare.gains == {"dusk": 2.0}
    sun = {"hdri": "dusk", "rotation": 1.0, "sun_irradiance": 3.0, "sun_azimuth": 0.5, "sun_elevation": 0.7}
    ours = relights_of(scene({"relights": [sun], "settings": {"roughness": "0.5", "specular": "0.25"}}))
    assert ours.lights == [Lighting(**sun)] and ours.gloss == Gloss(0.5, 0.25)


@pytest.mark.slow
@pytest.mark.skipif("DANTEW_BPY_PYTHON" not in os.environ, reason="needs a Python with bpy")
def test_scenes_from_meshes_resumed_and_faulty(tmp_path: Path, monkeypatch, capsys):
    """A usable object becomes a whole scene, a faulty one a sentence; a lost picture comes back with the same bytes."""
    random = np.random.default_rng(0)
    for name in ("tile", "torn"):
        write(tmp_path / f"things/{name}/albedo.png", random.uniform(0.2, 0.8, (16, 8, 3)))
    quad = "v 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\n{}f {}\n"
    corners = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    (tmp_path / "things/tile/mesh.obj").write_text(quad.format(corners, "1/1 2/2 3/3 4/4"))
    (tmp_path / "things/torn/mesh.obj").write_text("v 0 0 0\n")
    for name in ("noon", "dawn", "dusk"):
        sky = tmp_path / f"skies/{name}.exr"
        write(sky, random.uniform(0.5, 1.0, (16, 32, 3)))
    counts = "--photos 2 --test 1 --lightings 1 --size 16 --samples 1 --texture-size 8"
    out = tmp_path / "out"
    command = ["make_gigalit", str(tmp_path / "things"), str(tmp_path / "skies"), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", [*command, *counts.split()])

    assert make_gigalit.main() == 1
    said = capsys.readouterr()
    assert "left out: torn" in said.err and "no mesh" in said.err
    assert "true texture: 4 x 8" in said.out
    scene = out / "tile"
    whole = {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()}
    assert len(list(scene.glob("t*/*.png"))) == 2 + 1 + 2

    (scene / "train/001.png").unlink()
    make_gigalit.main()
    assert {file: file.read_bytes() for file in scene.rglob("*") if file.is_file()} == whole
