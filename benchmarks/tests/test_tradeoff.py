"""Accuracy against time: settings, kept runs, front and figure. Nothing is fitted here; see test_variant.py."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest
import tradeoff
from measure.curves import draw
from measure.pareto import PRESET, Row
from measure.pictures import read
from tradeoff import (
    BASE,
    FIELD,
    KNOBS,
    SEED,
    TRACED,
    Job,
    Setting,
    mean_row,
    measure,
    note,
    on_front,
    paces,
    settings,
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """As much of a scene as the names of kept runs hang on."""
    folder = tmp_path / "scenes/cup"
    (folder / "train").mkdir(parents=True)
    (folder / "mesh.obj").write_text("v 0 0 0")
    (folder / "transforms_train.json").write_text("{}")
    (folder / "transforms_test.json").write_text("{}")
    (folder / "train/000.png").write_bytes(b"photo")
    return folder


def facts(seconds: float, accuracy: float, name: str = "cup") -> dict:
    return {
        "object": name,
        "seconds": seconds,
        "stages": {"rays": 3.0, "optimise": 5.0, "final pass": 1.0},
        "scores": {"PSNR": accuracy - 5.0, "PSNR after gain": accuracy},
        "device": "cpu",
    }


@pytest.fixture
def runs(monkeypatch) -> list[str]:
    """The labels of the settings that `tradeoff` runs, with made-up results."""
    made: list[str] = []

    def run(setting: Setting, scene: Path, device: str, out: Path) -> dict:
        made.append(setting.label)
        return facts(10.0 + len(made), 20.0, scene.name)

    monkeypatch.setattr(tradeoff, "run", run)
    return made


@pytest.mark.parametrize("irradiance", [TRACED, FIELD])
def test_every_knob_has_the_value_of_standard_and_others(irradiance):
    base = Setting(PRESET, BASE, irradiance=irradiance).content()
    for knob, values in KNOBS[irradiance].items():
        contents = [Setting(knob, label, changes, BASE, irradiance).content() for label, changes in values]
        assert contents.count(base) == 1, knob
        assert len({json.dumps(content) for content in contents}) == len(values) > 1


def test_standard_is_always_measured():
    assert [s.label for s in settings([], ["albedo-levels"], FIELD)] == [BASE, "8", "12", "16"]
    assert [s.label for s in settings(["high", "draft"], [])] == ["draft", BASE, "high"]


def test_presets_of_traced_light_that_do_the_same_are_one_run():
    def content(**changes) -> list:
        return Setting(PRESET, "", irradiance=TRACED, **changes).content()

    assert (
        content(changes={"traced.directions": 256})
        == content()
        == content(changes={"field.schedule.steps": 7})
    )
    assert content(preset="draft") != content(changes={"traced.directions": 64})  # it leaves suns out
    assert content(preset="high") != content()  # its textures may be larger


def test_options_and_changes_are_told_apart():
    setting = Setting("", "", {"--texture-size": 1024, "field.schedule.steps": 60})
    assert setting.options == ["--texture-size=1024"]
    assert setting.inside == {"field.schedule.steps": 60}


def test_expected_seconds_grow_with_the_samples():
    times = [
        Setting("", "", {"field.schedule.steps": n}, irradiance=FIELD).expected_seconds()
        for n in (60, 500, 2000)
    ]
    assert times == sorted(times) and times[2] > 3 * times[1]
    assert Setting("", "", preset="draft").expected_seconds() < Setting("", "").expected_seconds()


def test_a_kept_run_is_named_after_all_it_hangs_on(scene, tmp_path, monkeypatch):
    def name(changes: dict, preset: str = BASE, machine: str = "this") -> Path:
        tradeoff.scene_digest.cache_clear()
        return note(tmp_path, Setting("", "", changes, preset, FIELD), scene, [machine])

    plain = name({})
    assert name({"field.schedule.steps": 500}) == plain  # standard's own
    others = [
        name({"field.schedule.steps": 501}),
        name({"field.white_light": 0.5}),
        name({"--texture-size": 1024}),
        name({}, preset="draft"),
        name({}, machine="that"),
    ]
    (scene / "train/000.png").write_bytes(b"longer photo")
    others.append(name({}))
    (scene / "transforms_train.json").write_text("[]")
    others.append(name({}))
    monkeypatch.setattr(tradeoff, "code_digest", lambda: "other code")
    others.append(name({}))
    assert len({plain, *others}) == 1 + len(others)


def test_code_digest_sees_the_backend(tmp_path, monkeypatch):
    names = ["backend/dante_w/field/fit.py", "benchmarks/methods/variant.py"]
    names += [f"benchmarks/measure/{name}.py" for name in ("score", "metrics", "views", "pictures")]
    monkeypatch.setattr(tradeoff, "ROOT", tmp_path)
    monkeypatch.setattr(tradeoff, "VARIANT", tmp_path / names[1])
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    digests = set()
    for name in [None, *names]:
        if name:
            (tmp_path / name).write_text("2")
        digests.add(tradeoff.code_digest())
    assert len(digests) == 1 + len(names)


def test_finished_runs_are_not_repeated(scene, tmp_path, runs):
    options = argparse.Namespace(out=tmp_path / "out", device="auto", minutes=1e3)
    wanted = settings(["draft"], ["steps"], FIELD)
    jobs = [Job(each, scene, note(options.out, each, scene, [])) for each in wanted]
    measure(jobs[:2], options)
    assert runs == ["warm-up", "draft", BASE]
    measure(jobs, options)
    assert runs[3:] == ["warm-up", "60", "150", "500", "1000", "2000"]  # 500 is standard again
    assert sorted(options.out.rglob("*.partial")) == []
    measure(jobs, options)
    assert len(runs) == 9
    assert all(tradeoff.read(job.file)["device"] == "cpu" for job in jobs)


def test_a_failed_run_is_left_out_and_tried_again(scene, tmp_path, runs, monkeypatch, capsys):
    options = argparse.Namespace(out=tmp_path / "out", device="auto", minutes=1e3)
    jobs = [Job(each, scene, note(options.out, each, scene, [])) for each in settings(["draft"], [])]
    works = tradeoff.run

    def fails(setting: Setting, *arguments) -> dict:
        if setting.label == "draft":
            raise RuntimeError("The fit diverged.")
        return works(setting, *arguments)

    monkeypatch.setattr(tradeoff, "run", fails)
    measure(jobs, options)
    assert "preset draft, cup is left out: The fit diverged." in capsys.readouterr().err
    monkeypatch.setattr(tradeoff, "run", works)
    measure(jobs, options)
    assert runs == ["warm-up", BASE, "warm-up", "draft"]


def test_nothing_is_kept_when_the_code_changes_under_way(scene, tmp_path, runs, monkeypatch):
    options = argparse.Namespace(out=tmp_path / "out", device="auto", minutes=1e3)
    job = Job(Setting(PRESET, BASE), scene, tmp_path / "run.json")
    digests = iter(["before", "after"])
    monkeypatch.setattr(tradeoff, "code_digest", lambda: next(digests))
    with pytest.raises(SystemExit, match="code was changed"):
        measure([job], options)
    assert runs == ["warm-up", BASE] and not job.file.exists()


def test_no_run_begins_that_would_end_too_late(scene, tmp_path, runs):
    options = argparse.Namespace(out=tmp_path, device="auto", minutes=0.1)
    measure([Job(Setting(PRESET, BASE), scene, tmp_path / "run.json")], options)
    assert runs == []


def test_main_goes_on_where_it_stopped(scene, tmp_path, runs, monkeypatch, capsys):
    out = tmp_path / "out"
    arguments = ["tradeoff", str(scene.parent), "--out", str(out), "--irradiance", "field"]
    arguments += ["--knobs", "mlp-width", "--json"]
    monkeypatch.setattr("sys.argv", [*arguments, "--presets", "draft"])
    tradeoff.main()
    assert runs == ["warm-up", "draft", BASE, "16", "32", "64"]
    monkeypatch.setattr("sys.argv", [*arguments, "--minutes", "2"])
    tradeoff.main()
    assert runs[6:] == []  # `high` would take longer
    assert "1 of 6 settings still miss runs" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", arguments)
    tradeoff.main()
    assert runs[6:] == ["warm-up", "high"]
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert content == json.loads((out / "tradeoff-field.json").read_text())
    assert [row["label"] for row in content["rows"]] == ["draft", BASE, "high", "16", "32", "64"]
    assert content["made_with"]["device"] == "cpu" and content["made_with"]["objects"] == "cup"
    assert [run["knob"] for run in content["runs"]] == [PRESET] * 3 + ["mlp-width"] * 3
    assert set(content["paces"]) == {PRESET, "mlp-width"}
    assert (out / "tradeoff-field.png").is_file()


def test_row_is_the_mean_over_objects():
    row = mean_row(Setting("steps", "60"), [facts(10.0, 20.0), facts(30.0, 23.0)], 1.0)
    assert row == Row("steps", "60", 20.0, 6.0, 16.5, 21.5)


def test_seconds_do_not_hang_on_when_a_knob_was_measured():
    """The machine is half as fast for the second knob, and a third knob misses a run."""
    runs = [
        (Setting("steps", "500", irradiance=FIELD), [facts(20.0, 20.0), facts(40.0, 20.0)]),
        (
            Setting("steps", "60", {"field.schedule.steps": 60}, irradiance=FIELD),
            [facts(8.0, 20.0), facts(16.0, 20.0)],
        ),
        (Setting("rays", "1", irradiance=FIELD), [facts(40.0, 20.0), facts(80.0, 20.0)]),
        (
            Setting("rays", "1/4", {"field.schedule.batch": 256}, irradiance=FIELD),
            [facts(16.0, 20.0), facts(32.0, 20.0)],
        ),
        (Setting("seed", "0", irradiance=FIELD), [facts(40.0, 20.0), {}]),
    ]
    pace = paces(runs)
    assert pace == {"steps": pytest.approx(2 / 3), "rays": pytest.approx(4 / 3)}
    seconds = [mean_row(setting, found, pace[setting.knob]).seconds for setting, found in runs[:4]]
    assert seconds == pytest.approx([45.0, 18.0, 45.0, 18.0])


def test_a_lucky_seed_is_not_on_the_front():
    values = [(PRESET, 40.0, 24.0), (SEED, 39.0, 25.0), ("steps", 13.0, 22.0), ("steps", 41.0, 23.0)]
    rows = [Row(knob, "", seconds, 0.0, 0.0, accuracy) for knob, seconds, accuracy in values]
    front, near, chance = on_front(rows)
    assert front.tolist() == near.tolist() == [True, False, True, False] and chance == 0.0


def test_what_chance_decides_is_said():
    values = [
        ("steps", 30.0, 24.1),
        (PRESET, 33.0, 24.05),
        ("rays", 35.0, 23.9),
        (SEED, 33.0, 24.05),
        (SEED, 32.0, 23.95),
    ]
    front, near, chance = on_front(
        [Row(knob, "", seconds, 0.0, 0.0, accuracy) for knob, seconds, accuracy in values]
    )
    assert front.tolist() == [True, False, False, False, False]
    assert near.tolist() == [True, True, False, False, False]
    assert chance == pytest.approx(0.1)


def test_figure_is_a_small_picture(tmp_path):
    random = np.random.default_rng(2)
    rows = [
        Row(s.knob, s.label, s.expected_seconds(), 0.0, 0.0, 24.0 + random.normal())
        for s in settings(["draft", "standard", "high"], list(KNOBS[FIELD]), FIELD)
    ]
    pictures = []
    for name, front in (("marked", on_front(rows)[0]), ("plain", np.zeros(len(rows), bool))):
        draw(tmp_path / name / "figure.png", rows, front, "made up")
        assert (tmp_path / name / "figure.png").stat().st_size < 200_000
        pictures.append(read(tmp_path / name / "figure.png")[0])
    assert (pictures[0] != pictures[1]).any()
    draw(tmp_path / "one.png", rows[:1], np.array([True]), "a single dot")
    assert (tmp_path / "one.png").is_file()
