"""The command from end to end on a small scene: files, report, exit codes, cancelling."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import SQUARE, albedo_at, make_scene, photograph
from dante_w.commands import recover_traced
from dante_w.commands.cli import main
from dante_w.contract.scene_folder import read_scene
from dante_w.core.color import srgb_from_linear_array
from dante_w.field.optimise import Schedule
from dante_w.scene.images import read_texture, write_exr, write_png
from small_settings import small_preset

SIZE = 64
STAGES = ["scene", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"]
FIELD_STAGES = ["scene", "rays", "optimise", "held-out", "final pass", "bake", "write"]
FIELD = ("--irradiance", "field")
PARTS = ["groups", "exposures", "bounce", "gloss", "sun"]
PLAN = [
    *("texture", "light", "normals", "directions", "samples", "memory", "time"),
    *("clusters", "exposures", "bounce", "specular", "sun"),
]
FIELD_PLAN = ["texture", "light", "samples", "memory", "albedo", "embedding", "exposures"]


SMALL = small_preset(SIZE)


def run(capsys, *arguments: str | Path) -> tuple[int, list[dict]]:
    code = main([str(a) for a in arguments] + ["--json"], settings=SMALL)
    return code, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def accuracy(folder: Path, name: str = "albedo.png", gain: bool = False) -> float:
    """PSNR in dB of sRGB colours against the painted albedo, away from the rim; after one gain per channel."""
    centres = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(centres, 1.0 - centres)
    truth = albedo_at(np.stack([u, v], axis=-1))[6:-6, 6:-6]
    found = read_texture(folder / name)[6:-6, 6:-6]
    if gain:
        found = found * ((found * truth).sum((0, 1)) / (found**2).sum((0, 1)))
    error = srgb_from_linear_array(found.clip(0, 1)) - srgb_from_linear_array(truth)
    return float(-10.0 * np.log10((error**2).mean()))


def test_the_papers_model_recovers_better_than_the_average(scene, tmp_path, capsys):
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "ours", *FIELD)
    assert code == 0
    assert run(capsys, "average", scene, "--out", tmp_path / "mean", "--texture-size", str(SIZE))[0] == 0
    ours, mean = (accuracy(tmp_path / name, gain=True) for name in ("ours", "mean"))
    assert ours > mean + 1.0
    assert ours > 24.0

    stages = list(dict.fromkeys(event["stage"] for event in events))
    assert stages == ["scene", "expected", "rays", "planned", *FIELD_STAGES[2:], "done"]
    for event in events[:-1]:
        if event["stage"] in ("expected", "planned"):
            continue
        assert set(event) == {"stage", "step", "total", "loss", "seconds_left"}
        assert 0 <= event["step"] <= event["total"]
    report = json.loads((tmp_path / "ours/report.json").read_text())
    assert report == events[-1]["report"]
    assert report["texture_size"] == SIZE and report["photos"] == 8
    assert report["held_out_psnr"] > 24.0
    assert 0.9 < report["coverage"] <= 1.0
    assert report["peak_memory_bytes"] > 1 << 26
    assert list(report["seconds"]) == ["start", *FIELD_STAGES]
    (said,) = (event for event in events if event["stage"] == "expected")
    assert said == {"stage": "expected", **report["expected"]}
    assert list(report["expected"]["seconds"]) == list(report["seconds"])
    assert report["expected"]["albedo_psnr_after_gain"]["mean"] > 20.0
    assert sorted(p.name for p in (tmp_path / "ours").iterdir()) == [
        "albedo.png",
        "coverage.png",
        "report.json",
    ]


def test_people_are_told_before_the_work_begins(scene, tmp_path, capsys):
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *FIELD], settings=SMALL) == 0
    line, *plan = capsys.readouterr().err.splitlines()
    assert line.startswith("standard: about ") and "dB" in line
    assert [line.split(":")[0] for line in plan] == FIELD_PLAN


@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_same_seed_same_bytes(scene, tmp_path, capsys, irradiance):
    for name in "ab":
        options = ("--irradiance", irradiance, "--seed", "3")
        assert run(capsys, "recover", scene, "--out", tmp_path / name, *options)[0] == 0
    first, again = ((tmp_path / n / "albedo.png").read_bytes() for n in "ab")
    assert first == again


def test_another_seed_another_fit(scene, tmp_path, capsys):
    for name, seed in (("a", "3"), ("b", "4")):
        assert run(capsys, "recover", scene, "--out", tmp_path / name, *FIELD, "--seed", seed)[0] == 0
    assert (tmp_path / "a/albedo.png").read_bytes() != (tmp_path / "b/albedo.png").read_bytes()


def write_priors(scene: Path, folder: Path) -> Path:
    """What a faultless network would say of each photo."""
    folder.mkdir()
    for index, frame in enumerate(read_scene(scene).frames):
        unlit = photograph(frame.camera, frame.camera_to_world, gain=1.0, slope=0.0)
        write_png(folder / f"{index}.png", unlit)
    return folder


def test_in_the_papers_model_a_good_prior_decides_level_and_colour(scene, tmp_path, capsys):
    priors = write_priors(scene, tmp_path / "priors")
    for name, extra in (("both", []), ("lifted", ["--no-photometric"]), ("ignored", ["--lambda", "0"])):
        out = tmp_path / name
        code, events = run(capsys, "recover", scene, "--out", out, "--priors", priors, *FIELD, *extra)
        assert code == 0 and events[-1]["report"]["priors"] == 8
        reached = events[-1]["report"]["expected"]["albedo_psnr_after_gain"]
        assert (reached is None) == (name != "ignored"), "with priors they decide, so nothing is promised"
    assert accuracy(tmp_path / "both") > 24.0
    assert accuracy(tmp_path / "lifted") > 24.0
    assert accuracy(tmp_path / "ignored") < accuracy(tmp_path / "both") - 3.0


@pytest.mark.parametrize(("kind", "name"), [("png16", "albedo.png"), ("exr", "albedo.exr")])
def test_other_formats_hold_the_same_texture(scene, tmp_path, capsys, kind, name):
    assert run(capsys, "recover", scene, "--out", tmp_path / "png")[0] == 0
    assert run(capsys, "recover", scene, "--out", tmp_path / kind, "--format", kind)[0] == 0
    eight = read_texture(tmp_path / "png/albedo.png")
    np.testing.assert_allclose(read_texture(tmp_path / kind / name), eight, atol=0.006)


def test_keep_held_out_skips_the_final_pass(scene, tmp_path, capsys):
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "out", *FIELD, "--keep-held-out")
    assert code == 0
    assert "final pass" not in {event["stage"] for event in events}
    assert "final pass" not in events[-1]["report"]["expected"]["seconds"]
    assert events[-1]["report"]["held_out_photos"] == ["4.png"]


def test_few_photos_hold_none_out(tmp_path, capsys):
    few = make_scene(tmp_path / "s", photos=2)
    code, events = run(capsys, "recover", few, "--out", tmp_path / "out", *FIELD)
    assert code == 0
    assert events[-1]["report"]["held_out_psnr"] is None


def test_a_mesh_without_uvs_is_unwrapped_on_request(scene, tmp_path, capsys):
    (scene / "mesh.obj").write_text(re.sub(r"/\d", "", re.sub("vt.*\n", "", SQUARE)))
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "out")
    assert code == 2 and "--unwrap" in events[-1]["message"]
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "out", "--unwrap")
    assert code == 0 and "unwrap" in {event["stage"] for event in events}
    assert (tmp_path / "out/mesh.obj").read_text().count("\nvt ") >= 3
    assert sorted(events[-1]["report"]["files"]) == sorted(path.name for path in (tmp_path / "out").iterdir())


def test_colmap_scenes_give_the_same_result(scene, tmp_path, capsys):
    content = json.loads((scene / "transforms.json").read_text())
    parent = tmp_path / "colmap"
    (parent / "sparse/0").mkdir(parents=True)
    (parent / "pictures").mkdir()
    shutil.copy(scene / "mesh.obj", parent)
    fx, fy, cx, cy = (content[k] for k in ("fl_x", "fl_y", "cx", "cy"))
    (parent / "sparse/0/cameras.txt").write_text(f"1 PINHOLE 48 36 {fx} {fy} {cx} {cy}\n")
    lines = []
    for index, frame in enumerate(content["frames"]):
        position = np.array(frame["transform_matrix"])[:3, 3]
        # looking down -z, y up: COLMAP's axes are the world's turned half about x
        turned = -position * (1, -1, -1)
        lines.append(f"{index + 1} 0 1 0 0 {turned[0]} {turned[1]} {turned[2]} 1 {frame['file_path']}\n\n")
        shutil.copy(scene / frame["file_path"], parent / "pictures")
    (parent / "sparse/0/images.txt").write_text("".join(lines))
    assert run(capsys, "recover", scene, "--out", tmp_path / "a")[0] == 0
    assert run(capsys, "recover", parent, "--images", parent / "pictures", "--out", tmp_path / "b")[0] == 0
    a, b = (read_texture(tmp_path / n / "albedo.png") for n in "ab")
    np.testing.assert_allclose(a, b, atol=0.02)


def broken_scenes(folder: Path) -> dict[str, tuple[list[str], str]]:
    """Arguments and what the message must name, for each kind of bad input; made in `folder`."""
    cases: dict[str, tuple[list[str], str]] = {}

    def case(name: str, message: str, *extra: str) -> Path:
        made = make_scene(folder / name, photos=2)
        cases[name] = ([str(made), *extra], message)
        return made

    (case("missing image", r"1\.png") / "1.png").unlink()
    (case("unreadable image", r"1\.png") / "1.png").write_bytes(b"\x89PNG\r\n\x1a\nnot really")
    write_png(
        case("image size unlike its camera", r"1\.png.*40 x 30") / "1.png", np.zeros((30, 40, 3), np.uint8)
    )
    made = case("nan pose", "frame 0") / "transforms.json"
    made.write_text(
        re.sub(r'"transform_matrix": \[\[[0-9.]+', '"transform_matrix": [[NaN', made.read_text(), count=1)
    )
    (case("empty mesh", r"mesh\.obj") / "mesh.obj").write_text("")
    (case("no mesh", "--mesh") / "mesh.obj").unlink()
    (case("overlapping uvs", "--unwrap") / "mesh.obj").write_text(
        SQUARE.replace("f 1/1 3/3 4/4", "f 1/1 3/2 4/3")
    )
    (case("no pixel sees the mesh", "coordinate system") / "mesh.obj").write_text(
        re.sub(r"v (\d) (\d) 0", r"v 9\1 9\2 0", SQUARE)
    )
    case("no such priors", "priors", "--priors", str(folder / "nowhere"))
    case("nothing to fit to", "--priors", "--no-photometric")
    cases["no scene"] = ([str(folder / "nothing")], "nothing")
    if not os.path.exists("/dev/nvidiactl"):
        case("no such device", "--device cuda", *FIELD, "--device", "cuda")
    return cases


def test_bad_input_ends_in_one_sentence_and_loses_nothing(tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "albedo.png").write_text("former result")
    (out / "report.json").write_text(json.dumps({"dante_w": "0.1.0", "files": ["albedo.png", "report.json"]}))
    for name, (arguments, message) in broken_scenes(tmp_path).items():
        code = main(["recover", *arguments, "--out", str(out), "--json"], settings=SMALL)
        captured = capsys.readouterr()
        last = json.loads(captured.out.splitlines()[-1])
        assert (code, last["stage"], last["code"]) == (2, "error", 2), (name, last)
        assert re.search(message, last["message"]), (name, last["message"])
        assert "\n" not in last["message"] and "Traceback" not in captured.err, name
        assert sorted(p.name for p in out.iterdir()) == ["albedo.png", "report.json"], name
    assert (out / "albedo.png").read_text() == "former result"


def test_wrong_options_are_bad_input_too(capsys, monkeypatch):
    for arguments in (["recover"], ["recover", "x", "--out", "y", "--texture-size", "0"], ["fly"]):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 2


def test_memory_and_disk_have_their_own_exit_code(scene, tmp_path, capsys, monkeypatch):
    def fail(error):
        def raise_it(*_):
            raise error

        return raise_it

    for error in (MemoryError(), OSError(28, "No space left on device", "albedo.png")):
        monkeypatch.setattr(recover_traced, "look", fail(error))
        code, events = run(capsys, "recover", scene, "--out", tmp_path / "out")
        assert code == 4 and events[-1]["code"] == 4
        assert not (tmp_path / "out").exists()
    monkeypatch.setattr(recover_traced, "look", fail(ZeroDivisionError("a bug")))
    assert run(capsys, "recover", scene, "--out", tmp_path / "out")[0] == 1


def test_a_fit_that_diverges_is_no_success(scene, tmp_path, capsys):
    schedule = Schedule(20, 2048, float("inf"))
    wild = dataclasses.replace(SMALL, field=dataclasses.replace(SMALL.field, schedule=schedule))
    assert main(["recover", str(scene), "--out", str(tmp_path / "out"), *FIELD, "--json"], settings=wild) == 1
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "diverged" in events[-1]["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM to handle")
@pytest.mark.parametrize(
    ("wanted", "irradiance"), [("rays", "field"), ("optimise", "field"), ("lights", "traced")]
)
def test_signals_end_the_run_within_a_second(scene, tmp_path, wanted, irradiance):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "dante_w",
        "recover",
        str(scene),
        "--out",
        str(out),
        "--preset",
        "paper" if irradiance == "field" else "high",
        "--irradiance",
        irradiance,
        "--json",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if json.loads(line)["stage"] == wanted:
                break
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        rest = process.stdout.read().splitlines()
        assert process.wait(10) == 3
        assert time.monotonic() - began < 3.0  # a second, on a machine with nothing else to do
    assert json.loads(rest[-1]) == {
        "stage": "error",
        "code": 3,
        "message": "Cancelled; the former result, if any, is untouched.",
    }
    assert not out.exists()


def test_traced_light_recovers_better_than_the_average(scene, tmp_path, capsys):
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "ours")
    assert code == 0
    assert run(capsys, "average", scene, "--out", tmp_path / "mean", "--texture-size", str(SIZE))[0] == 0
    ours, mean = (accuracy(tmp_path / name, gain=True) for name in ("ours", "mean"))
    assert ours > mean + 1.0
    said = {"planned", "expected"}
    stages = list(dict.fromkeys(event["stage"] for event in events if event["stage"] not in said))
    assert stages == [*STAGES, "done"]
    assert [event["stage"] for event in events if event["stage"] in said] == ["expected", "planned"]
    (expected,) = (event for event in events if event["stage"] == "expected")
    report = json.loads((tmp_path / "ours/report.json").read_text())
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
    names = sorted(p.name for p in (tmp_path / "ours").iterdir())
    assert names == ["albedo.png", "coverage.png", "report.json"]


def test_the_plan_is_said_and_reported(scene, tmp_path, capsys):
    options = ("--model", "groups", "--leave-out", "gloss")
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "out", *options)
    assert code == 0
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


def test_a_plan_alone_leaves_nothing_behind(scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    before = sorted(scene.iterdir())
    code, events = run(capsys, "plan", scene, "--leave-out", "bounce")
    assert code == 0
    said, done = events[-2:]
    assert said["stage"] == "planned" and done["stage"] == "done"
    assert done["report"]["plan"] == said["decisions"]
    assert {decision["what"]: decision["choice"] for decision in said["decisions"]}["bounce"] == "off"
    for extra, lines in (((), PLAN), (FIELD, FIELD_PLAN)):
        assert main(["plan", str(scene), *extra], settings=SMALL) == 0
        out, err = capsys.readouterr()
        assert [line.split(":")[0] for line in out.splitlines()] == lines and err == ""
    assert run(capsys, "plan", tmp_path / "nothing")[0] == 2
    assert sorted(scene.iterdir()) == before and list((tmp_path / "temporary").iterdir()) == []


def test_priors_bring_traced_light_to_the_right_level(scene, tmp_path, capsys):
    priors = write_priors(scene, tmp_path / "priors")
    for name, extra in (("without", []), ("with", ["--priors", priors])):
        code, events = run(capsys, "recover", scene, "--out", tmp_path / name, *extra)
        assert code == 0 and events[-1]["report"]["priors"] == (8 if extra else 0)
    assert run(capsys, "recover", scene, "--out", tmp_path / "ignored", *extra, "--lambda", "0")[0] == 0
    assert accuracy(tmp_path / "with") > 24.0
    assert accuracy(tmp_path / "with") > accuracy(tmp_path / "without") + 3.0
    assert (tmp_path / "ignored/albedo.png").read_bytes() == (tmp_path / "without/albedo.png").read_bytes()


def colour_at(folder: Path, u: float, v: float) -> np.ndarray:
    """Median linear albedo (3,) around a texture coordinate."""
    row, column = int((1.0 - v) * SIZE), int(u * SIZE)
    return np.median(
        read_texture(folder / "albedo.png")[row - 2 : row + 2, column - 2 : column + 2], axis=(0, 1)
    )


@pytest.mark.parametrize("irradiance", ["traced", "field"])
def test_known_colours_are_met(scene, tmp_path, capsys, irradiance):
    """The spots lie in the middle of checks: one reddish, one bluish."""
    truth = albedo_at(np.array([0.625, 0.375]))
    red, green, blue = np.rint(255 * srgb_from_linear_array(truth)).astype(int)
    known = ("--known", "0.625", "0.375", f"#{red:02x}{green:02x}{blue:02X}")
    code, events = run(
        capsys, "recover", scene, "--out", tmp_path / "out", "--irradiance", irradiance, *known
    )
    assert code == 0
    np.testing.assert_allclose(colour_at(tmp_path / "out", 0.625, 0.375), truth, rtol=0.05)
    report = events[-1]["report"]
    (said,) = report["settings"]["known"]
    assert (said["u"], said["v"]) == (0.625, 0.375)
    assert accuracy(tmp_path / "out") > 22.0
    assert len(report["albedo_gain"]) == 3 and max(abs(gain - 1.0) for gain in report["albedo_gain"]) > 0.05


def test_a_spot_known_to_be_grey_becomes_grey(scene, tmp_path, capsys):
    known = ("--known", "0.375", "0.375", "grey")
    code, events = run(capsys, "recover", scene, "--out", tmp_path / "out", *known)
    assert code == 0
    found = colour_at(tmp_path / "out", 0.375, 0.375)
    np.testing.assert_allclose(found, found.mean(), rtol=0.05)
    assert np.prod(events[-1]["report"]["albedo_gain"]) == pytest.approx(1.0, abs=1e-3)


def test_known_colours_that_say_nothing_are_refused(scene, tmp_path, capsys):
    (scene / "mesh.obj").write_text(SQUARE.replace("vt 1 ", "vt 0.5 "))  # half of the texture is empty
    unseen = ("--known", "0.9", "0.5", "grey")
    for extra, message in ((unseen, "No photo saw .* 0.9 0.5"), ((*unseen, "--unwrap"), "--unwrap")):
        code, events = run(capsys, "recover", scene, "--out", tmp_path / "out", *extra)
        assert code == 2 and re.search(message, events[-1]["message"])
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [("0.5", "1.5", "grey"), ("0.5", "0.5", "red"), ("0.5", "0.5", "#00FFFF")])
def test_known_colours_that_make_no_sense_are_one_sentence(scene, tmp_path, capsys, monkeypatch, words):
    arguments = ["recover", str(scene), "--out", str(tmp_path / "out"), "--known", *words, "--json"]
    monkeypatch.setattr(sys, "argv", ["dante-w", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    (line,) = capsys.readouterr().out.splitlines()
    said = json.loads(line)
    assert (said["stage"], said["code"]) == ("error", 2)
    assert " ".join(words) in said["message"] and "\n" not in said["message"]


@pytest.mark.parametrize("ablation", ["--equal-bands", "--no-photometric"])
def test_ablations_belong_to_the_papers_model(scene, tmp_path, capsys, ablation):
    out = tmp_path / "out"
    code, events = run(capsys, "recover", scene, "--out", out, "--irradiance", "traced", ablation)
    assert (code, events[-1]["stage"], events[-1]["code"]) == (2, "error", 2)
    assert "--irradiance" in events[-1]["message"] and "\n" not in events[-1]["message"]
    assert not out.exists()
    code, events = run(capsys, "recover", scene, "--out", out, "--equal-bands")
    assert code == 0 and "optimise" in {event["stage"] for event in events}


@pytest.mark.parametrize("photos", [1, 2, 3])
def test_traced_light_manages_with_few_photos(tmp_path, capsys, photos):
    """It either recovers something finite or says in one sentence what is missing; it is never a bug."""
    folder = make_scene(tmp_path / "s", photos=photos)
    code, events = run(capsys, "recover", folder, "--out", tmp_path / "out")
    assert code in (0, 2), events[-1]
    assert code == 0 or "photo" in events[-1]["message"]
    assert code == 0 or photos < 3


def test_float_photos_with_nan_pixels(tmp_path, capsys):
    folder = make_scene(tmp_path / "s", photos=3)
    for index in range(3):
        linear = read_texture(folder / f"{index}.png")
        linear[3, 4] = np.nan
        write_exr(folder / f"{index}.exr", linear.astype(np.float32))
    text = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(text.replace(".png", ".exr"))
    assert run(capsys, "recover", folder, "--out", tmp_path / "out")[0] == 0
    assert np.isfinite(read_texture(tmp_path / "out/albedo.png")).all()


def test_doctor_names_device_libraries_and_memory(capsys):
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"device", "torch", "numba", "free_memory_gib", "cuda"} <= set(found)
    assert main(["doctor"]) == 0
    assert "device:" in capsys.readouterr().out
