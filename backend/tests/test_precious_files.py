"""What lies in or behind a result folder and is not a result of ours stays as it is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dante_w.commands.cli import main
from dante_w.contract.errors import BadInput
from dante_w.run import checkpoints, own_folders, result_folder
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.result_files import FILES, REPORT, names_written, refuse_inputs

NAMES = ("albedo.png", "coverage.png", REPORT)


def report(**more: object) -> str:
    return json.dumps({"dante_w": "0.1.0", **more})


def content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, and where each link leads."""
    return {
        str(path.relative_to(folder)): os.readlink(path).encode() if path.is_symlink() else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


@pytest.fixture
def dead() -> str:
    """The token of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return f"{process.pid}-1700000000"


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """A folder that nothing may happen to, though it looks like a staged result to anybody who follows a link."""
    folder = tmp_path / "precious"
    folder.mkdir()
    for name in (*FILES, "letters.txt"):
        (folder / name).write_text("precious")
    return folder


def write_result(out: Path, names: tuple[str, ...] = NAMES) -> None:
    """Write a result as a run does."""
    staging = result_folder.stage(out, names)
    for name in names:
        (staging / name).write_text(report(files=names) if name == REPORT else "new")
    result_folder.publish(out)


def average(capsys, *words: object) -> tuple[int, str]:
    """Exit code and error of the command `average`."""
    code = main(["average", *map(str, words), "--texture-size", "16", "--json"])
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    return code, last.get("message", "")


LINKS = [".whole", ".partial", ".doomed", ".resume", ".whole-{}", ".partial-{}", ".doomed-{}"]


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("scene_is_there", [True, False])
def test_a_link_is_removed_and_what_it_points_to_stays(
    scene, tmp_path, precious, dead, capsys, name, scene_is_there
):
    own_folders.mark(precious, dead)
    before, out = content(precious), tmp_path / "out"
    out.mkdir()
    (out / name.format(dead)).symlink_to(precious, target_is_directory=True)
    code, _ = average(capsys, scene if scene_is_there else tmp_path / "nowhere", "--out", out)
    assert code == (0 if scene_is_there else 2)
    assert content(precious) == before
    if scene_is_there:
        assert sorted(os.listdir(out)) == sorted(NAMES)


@pytest.mark.parametrize("name", [".whole-{}", ".partial-{}", ".doomed-{}", ".whole", ".resume"])
def test_a_folder_that_nobody_marked_is_nobodys(tmp_path, precious, dead, name):
    out, before = tmp_path / "out", content(precious)
    out.mkdir()
    precious.rename(out / name.format(dead))
    result_folder.abandon(out)
    write_result(out)
    write_result(out)
    assert content(out / name.format(dead)) == before
    assert (out / "albedo.png").read_text() == "new"


@pytest.mark.parametrize("kind", ["of another", "a link"])
def test_a_mark_counts_for_its_owner_alone(tmp_path, precious, dead, kind):
    out = tmp_path / "out"
    out.mkdir()
    if kind == "a link":
        own_folders.mark(tmp_path, dead)
        (precious / own_folders.MARKER).symlink_to(tmp_path / own_folders.MARKER)
    else:
        own_folders.mark(precious, "1-1")
    before = content(precious)
    precious.rename(out / f".whole-{dead}")
    write_result(out)
    assert content(out / f".whole-{dead}") == before


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["file", "link", "dangling link", "folder"])
def test_what_no_earlier_run_wrote_is_refused_at_once(scene, tmp_path, capsys, name, kind):
    out, target = tmp_path / "out", tmp_path / "target"
    write_result(out)
    (out / name).unlink()
    if kind == "file":
        if name != REPORT:
            (out / REPORT).write_text("{}")
        (out / name).write_text("precious")
    elif kind == "folder":
        (out / name).mkdir()
    else:
        (out / name).symlink_to(target)
        if kind == "link":
            target.write_text(report(files=NAMES))
    before = content(tmp_path)
    code, message = average(capsys, scene, "--out", out)
    assert code == 2 and "choose another --out" in message and str(out) in message
    assert content(tmp_path) == before
    if kind == "dangling link":
        assert not target.exists()


def test_a_file_that_appears_during_a_run_stays(tmp_path):
    staging = result_folder.stage(tmp_path, NAMES)
    (staging / "albedo.png").write_text("new")
    (tmp_path / "albedo.png").write_text("precious")
    with pytest.raises(BadInput, match=r"albedo\.png"):
        result_folder.publish(tmp_path)
    result_folder.abandon(tmp_path)
    assert content(tmp_path) == {"albedo.png": b"precious"}


@pytest.mark.parametrize("mesh", ["scene's", "named"])
def test_unwrapping_into_the_scenes_folder_is_refused(scene, tmp_path, capsys, mesh):
    words = [scene, "--out", scene]
    if mesh == "named":
        (tmp_path / "other").mkdir()
        (scene / "mesh.obj").rename(tmp_path / "other" / "mesh.obj")
        words = [scene, "--mesh", tmp_path / "other" / "mesh.obj", "--out", tmp_path / "other"]
    before = content(tmp_path)
    for command in ("recover", "average"):
        code = main([command, *map(str, words), "--unwrap", "--json"])
        message = json.loads(capsys.readouterr().out.splitlines()[-1])["message"]
        assert code == 2 and "mesh.obj" in message and "choose another --out" in message
        assert content(tmp_path) == before


def test_a_result_in_the_scenes_folder_leaves_the_scene_as_it_is(scene, capsys):
    before = content(scene)
    for _ in range(2):
        assert average(capsys, scene, "--out", scene)[0] == 0
        assert content(scene).items() >= before.items()
    (scene / "albedo.exr").write_bytes(b"precious")
    code, message = average(capsys, scene, "--out", scene, "--format", "exr")
    assert code == 2 and "albedo.exr" in message and (scene / "albedo.exr").read_bytes() == b"precious"


def test_priors_and_photos_named_like_a_result_stay(scene, tmp_path, capsys):
    priors = tmp_path / "priors"
    priors.mkdir()
    (scene / "0.png").rename(scene / "albedo.png")
    text = (scene / "transforms.json").read_text()
    (scene / "transforms.json").write_text(text.replace('"0.png"', '"albedo.png"'))
    (priors / "albedo.png").write_bytes((scene / "albedo.png").read_bytes())
    before = content(tmp_path)
    for out in (scene, priors):
        for command in ("recover", "average"):
            more = ["--priors", str(priors)] if command == "recover" else []
            assert main([command, str(scene), *more, "--out", str(out), "--json"]) == 2
            assert str(out / "albedo.png") in json.loads(capsys.readouterr().out.splitlines()[-1])["message"]
            assert content(tmp_path) == before


@pytest.mark.parametrize("way", ["hard link", "same file", "link to it"])
def test_a_former_result_that_the_run_reads_is_refused(scene, tmp_path, capsys, way):
    out = tmp_path / "out"
    write_result(out, (*NAMES[:-1], "mesh.obj", REPORT))
    mesh = scene / "mesh.obj"
    if way == "hard link":
        (out / "mesh.obj").unlink()
        os.link(mesh, out / "mesh.obj")
    else:
        (out / "mesh.obj").write_bytes(mesh.read_bytes())
        mesh = out / "mesh.obj"
        if way == "link to it":
            mesh = tmp_path / "link.obj"
            mesh.symlink_to(out / "mesh.obj")
    before = content(tmp_path)
    code, message = average(capsys, scene, "--mesh", mesh, "--out", out)
    assert code == 2 and f"{out / 'mesh.obj'}: is read by this run" in message
    assert content(tmp_path) == before


def test_inputs_that_are_not_there_are_left_to_their_reader(tmp_path):
    write_result(tmp_path / "out")
    refuse_inputs(tmp_path / "out", [tmp_path / "nowhere.png"])


@pytest.mark.parametrize("stop", range(6))
def test_a_result_is_exactly_its_files_after_a_kill_too(tmp_path, monkeypatch, stop):
    write_result(tmp_path, ("albedo.exr", "coverage.png", "mesh.obj", REPORT))
    (tmp_path / "letters.txt").write_text("precious")
    calls: list[object] = []

    def struck(move):
        def moved(*paths):
            if len(calls) == stop:
                raise KeyboardInterrupt
            calls.append(paths)
            move(*paths)

        return moved

    with monkeypatch.context() as patch:
        for name in ("replace", "unlink"):
            patch.setattr(os, name, struck(getattr(os, name)))
        with pytest.raises(KeyboardInterrupt):
            write_result(tmp_path)
    result_folder.abandon(tmp_path)
    assert content(tmp_path) == {
        "albedo.png": b"new",
        "coverage.png": b"new",
        REPORT: report(files=NAMES).encode(),
        "letters.txt": b"precious",
    }


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (report(files=["albedo.exr", REPORT, "../letters.txt", 3]), ["albedo.exr", REPORT]),
        (report(settings={"unwrap": True}), list(FILES)),
        (report(settings={"unwrap": False}), [name for name in FILES if name != "mesh.obj"]),
        (json.dumps({"files": list(FILES)}), []),
        ("[", []),
        ("[1]", []),
    ],
)
def test_which_files_a_report_claims(tmp_path, text, names):
    (tmp_path / REPORT).write_text(text)
    assert names_written(tmp_path / REPORT) == names


def test_the_result_folder_itself_may_be_a_link(scene, tmp_path, capsys):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    assert average(capsys, scene, "--out", tmp_path / "out")[0] == 0
    assert sorted(os.listdir(tmp_path / "elsewhere")) == sorted(NAMES)


def test_checkpoints_are_not_written_through_links(tmp_path, precious, monkeypatch):
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    before = content(precious)
    (tmp_path / ".resume").symlink_to(precious, target_is_directory=True)
    Checkpoints(tmp_path / ".resume", "key").save("letters", {"a": np.ones(3)})
    assert content(precious) == before
    (tmp_path / ".resume").unlink()
    own_folders.make(tmp_path / ".resume", "key")
    for name in ("letters", "letters.partial"):
        (tmp_path / ".resume" / name).symlink_to(precious, target_is_directory=True)
    Checkpoints(tmp_path / ".resume", "key").save("letters", {"a": np.ones(3)})
    assert content(precious) == before
    assert Checkpoints(tmp_path / ".resume", "key").load("letters", dict[str, np.ndarray]) is not None


def test_checkpoints_are_read_from_their_own_files_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)
    keeper = Checkpoints(tmp_path / ".resume", "key")
    keeper.save("a", {"a": np.ones(3)})
    np.save(tmp_path / "other.npy", np.zeros(3))
    folder = tmp_path / ".resume" / "a"
    for name in ("../../other.npy", str(tmp_path / "other.npy")):
        (folder / "tree.json").write_text(json.dumps({"a": {"file": name}}))
        assert keeper.load("a", dict[str, np.ndarray]) is None
    (folder / "0.npy").unlink()
    (folder / "0.npy").symlink_to(tmp_path / "other.npy")
    (folder / "tree.json").write_text(json.dumps({"a": {"file": "0.npy"}}))
    assert keeper.load("a", dict[str, np.ndarray]) is None
    keeper.save("a", {"a": np.ones(3)})
    assert keeper.load("a", dict[str, np.ndarray]) is not None
    (tmp_path / ".resume").rename(tmp_path / "moved")
    (tmp_path / ".resume").symlink_to(tmp_path / "moved", target_is_directory=True)
    assert keeper.load("a", dict[str, np.ndarray]) is None
