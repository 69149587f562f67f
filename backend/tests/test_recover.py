"""The command from end to end with traced light: files, report, plan."""

from __future__ import annotations

import json
import re
import shutil
import tempfile

import numpy as np
import pytest
from command_runs import (
    FIELD,
    FIELD_PLAN,
    PLAN,
    SIZE,
    SMALL,
    accuracy,
    recover,
    run,
    write_priors,
)
from dante_w.commands.cli import main
from dante_w.scene.images import read_texture, write_exr
from square_scene import SQUARE, make_scene

STAGES = ["scene", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"]
PARTS = ["groups", "exposures", "bounce", "gloss", "sun"]


def test_traced_light_recovers_better_than_the_average(square, recovered, tmp_path):
    folder, events = recovered()
    assert run("average", square, "--out", tmp_path / "mean", "--texture-size", str(SIZE))[0] == 0
    assert accuracy(folder, gain=True) > accuracy(tmp_path / "mean", gain=True) + 1.0
    said = {"planned", "expected"}
    stages = list(dict.fromkeys(event["stage"] for event in events if event["stage"] not in said))
    assert stages == [*STAGES, "done"]
    assert [event["stage"] for event in events if event["stage"] in said] == ["expected", "planned"]
    (expected,) = (event for event in events if event["stage"] == "expected")
    report = json.loads((folder / "report.json").read_text())
    assert report == events[-1]["report"]
    assert list(report["seconds"]) == ["start", *STAGES] == list(report["expected"]["seconds"])
    assert expected == {"stage": "expected", **report["expected"]}
    assert all(seconds >= 0.0 for seconds in expected["seconds"].values())
    assert min(expected["seconds"][stage] for stage in ("transfer", "plan", "lights")) > 0.0
    assert len(report["lights"]) == report["photos"] == 8
    assert set(report["lights"]) == set(range(max(report["lights"]) + 1))
    assert report["held_out_photos"] == ["4.png"] and report["held_out_psnr"] > 24.0
    assert 500 < report["shading_points"] < 48 * 36 and report["texture_size"] == SIZE
    assert report["priors"] == 0 and report["albedo_gain"] == [1.0, 1.0, 1.0]
    assert 0.9 < report["coverage"] <= 1.0
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["albedo.png", "coverage.png", "report.json"]


@pytest.mark.parametrize(("kind", "name"), [("png16", "albedo.png"), ("exr", "albedo.exr")])
def test_other_formats_hold_the_same_texture(recovered, kind, name):
    eight = read_texture(recovered().folder / "albedo.png")
    np.testing.assert_allclose(read_texture(recovered("--format", kind).folder / name), eight, atol=0.006)


def test_the_same_seed_gives_the_same_bytes(square, recovered, tmp_path, capsys):
    """Also where people read along, who are told before the work begins."""
    out = tmp_path / "out"
    assert main(["recover", str(square), "--out", str(out)], settings=SMALL) == 0
    line, *plan = capsys.readouterr().err.splitlines()
    assert line.startswith("standard: about ") and "dB" in line
    assert [line.split(":")[0] for line in plan] == PLAN
    assert (out / "albedo.png").read_bytes() == (recovered().folder / "albedo.png").read_bytes()


def test_a_mesh_without_uvs_is_unwrapped_on_request(scene, tmp_path):
    (scene / "mesh.obj").write_text(re.sub(r"/\d", "", re.sub("vt.*\n", "", SQUARE)))
    code, events = run("recover", scene, "--out", tmp_path / "out")
    assert code == 2 and "--unwrap" in events[-1]["message"]
    result = recover(scene, tmp_path / "out", "--unwrap")
    assert "unwrap" in {event["stage"] for event in result.events}
    assert (result.folder / "mesh.obj").read_text().count("\nvt ") >= 3
    assert sorted(result.report["files"]) == sorted(path.name for path in result.folder.iterdir())


def test_colmap_scenes_give_the_same_result(square, recovered, tmp_path):
    content = json.loads((square / "transforms.json").read_text())
    parent = tmp_path / "colmap"
    (parent / "sparse/0").mkdir(parents=True)
    (parent / "pictures").mkdir()
    shutil.copy(square / "mesh.obj", parent)
    fx, fy, cx, cy = (content[k] for k in ("fl_x", "fl_y", "cx", "cy"))
    (parent / "sparse/0/cameras.txt").write_text(f"1 PINHOLE 48 36 {fx} {fy} {cx} {cy}\n")
    lines = []
    for index, frame in enumerate(content["frames"]):
        position = np.array(frame["transform_matrix"])[:3, 3]
        # looking down -z, y up: COLMAP's axes are the world's turned half about x
        turned = -position * (1, -1, -1)
        lines.append(f"{index + 1} 0 1 0 0 {turned[0]} {turned[1]} {turned[2]} 1 {frame['file_path']}\n\n")
        shutil.copy(square / frame["file_path"], parent / "pictures")
    (parent / "sparse/0/images.txt").write_text("".join(lines))
    result = recover(parent, tmp_path / "out", "--images", parent / "pictures")
    ours, theirs = (read_texture(each.folder / "albedo.png") for each in (recovered(), result))
    np.testing.assert_allclose(ours, theirs, atol=0.02)


def test_the_plan_is_said_and_reported(recovered):
    events = recovered("--model", "groups", "--leave-out", "gloss").events
    stages = [event["stage"] for event in events]
    assert stages.index("plan") < stages.index("planned") < stages.index("lights")
    (said,) = (event for event in events if event["stage"] == "planned")
    report = events[-1]["report"]
    assert said == {"stage": "planned", "decisions": report["plan"]}
    assert [decision["what"] for decision in report["plan"]] == PLAN and list(report["parts"]) == PARTS
    assert all(set(decision) == {"what", "choice", "reason", "costs"} for decision in report["plan"])
    assert report["parts"]["groups"] and not report["parts"]["gloss"]
    chosen = {decision["what"] for decision in report["plan"] if decision["reason"] == "you chose it"}
    assert chosen == {"clusters", "specular"}
    assert report["settings"]["model"] == ["groups"] and report["settings"]["leave_out"] == ["gloss"]


def test_a_plan_alone_leaves_nothing_behind(square, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    before = sorted(square.iterdir())
    code, events = run("plan", square, "--leave-out", "bounce")
    assert code == 0
    said, done = events[-2:]
    assert said["stage"] == "planned" and done["stage"] == "done"
    assert done["report"]["plan"] == said["decisions"]
    assert {decision["what"]: decision["choice"] for decision in said["decisions"]}["bounce"] == "off"
    for extra, lines in (((), PLAN), (FIELD, FIELD_PLAN)):
        assert main(["plan", str(square), *extra], settings=SMALL) == 0
        out, err = capsys.readouterr()
        assert [line.split(":")[0] for line in out.splitlines()] == lines and err == ""
    assert run("plan", tmp_path / "nothing")[0] == 2
    assert sorted(square.iterdir()) == before and list((tmp_path / "temporary").iterdir()) == []


def test_priors_bring_traced_light_to_the_right_level(square, recovered, tmp_path):
    priors, without = write_priors(square, tmp_path / "priors"), recovered()
    guided = recover(square, tmp_path / "guided", "--priors", priors)
    ignored = recover(square, tmp_path / "ignored", "--priors", priors, "--lambda", "0")
    assert (guided.report["priors"], without.report["priors"]) == (8, 0)
    assert accuracy(guided.folder) > 24.0
    assert accuracy(guided.folder) > accuracy(without.folder) + 3.0
    assert (ignored.folder / "albedo.png").read_bytes() == (without.folder / "albedo.png").read_bytes()


@pytest.mark.parametrize("photos", [1, 2, 3])
def test_traced_light_manages_with_few_photos(tmp_path, photos):
    """It either recovers something finite or says in one sentence what is missing; it is never a bug."""
    folder = make_scene(tmp_path / "s", photos=photos)
    code, events = run("recover", folder, "--out", tmp_path / "out")
    assert code in (0, 2), events[-1]
    assert code == 0 or "photo" in events[-1]["message"]
    assert code == 0 or photos < 3


def test_float_photos_with_nan_pixels(tmp_path):
    folder = make_scene(tmp_path / "s", photos=3)
    for index in range(3):
        linear = read_texture(folder / f"{index}.png")
        linear[3, 4] = np.nan
        write_exr(folder / f"{index}.exr", linear.astype(np.float32))
    text = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(text.replace(".png", ".exr"))
    result = recover(folder, tmp_path / "out")
    assert np.isfinite(read_texture(result.folder / "albedo.png")).all()


def test_doctor_names_device_libraries_and_memory(capsys):
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"device", "torch", "numba", "free_memory_gib", "cuda"} <= set(found)
    assert main(["doctor"]) == 0
    assert "device:" in capsys.readouterr().out
