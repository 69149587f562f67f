"""Making the backend's Python: which wheels, which commands, and what is asked of an interpreter."""

import sys
from pathlib import Path

import bpy
import pytest

from dante_w_addon.bridge import environment, job, process


@pytest.mark.parametrize(
    ("system", "nvidia", "index"),
    [
        ("Linux", False, "cpu"),
        ("Linux", True, None),
        ("Windows", False, None),
        ("Windows", True, "cu130"),
        ("Darwin", False, None),
    ],
)
def test_torch_index(system, nvidia, index):
    found = environment.torch_index(system, nvidia)
    assert found == (index and f"https://download.pytorch.org/whl/{index}")


def test_commands_install_wheels_only():
    make, install = environment.commands("python3", Path("/v"), Path("/r.txt"), "Linux", False)
    assert make[:4] == ["python3", "-I", "-m", "venv"] and make[-1] == "/v"
    assert "--only-binary" in install and install[install.index("-r") + 1] == "/r.txt"
    assert install[-2:] == ["--extra-index-url", "https://download.pytorch.org/whl/cpu"]


def test_windows_refuses_long_paths():
    with pytest.raises(ValueError, match="too long"):
        environment.commands("python", Path("C:/" + "a" * 100), Path("r.txt"), "Windows", False)


def test_a_python_that_is_none_is_passed_over(tmp_path):
    fake = tmp_path / "blender"
    fake.write_text("#!/bin/sh\nexit 7\n")
    fake.chmod(0o755)
    assert environment.base_python([str(fake), str(tmp_path / "missing")]) == sys.executable


def test_tasks_run_one_after_the_other(tmp_path):
    say = [sys.executable, "-I", "-c", "import sys; print('word', sys.argv[1])"]
    job.start_task("Test", [[*say, "one"], [*say, "two"]])
    while job.tick() is not None:
        pass
    assert job.task.state == "done" and job.task.lines == ["word two"]
    job.start_task("Test", [[sys.executable, "-I", "-c", "import sys; sys.exit('no room')"], [*say, "never"]])
    while job.tick() is not None:
        pass
    assert job.task.state == "failed" and job.task.lines == ["no room"]


def test_a_real_environment_is_made(tmp_path):
    """The venv command for real; the install step with no requirements, so that nothing is downloaded."""
    requirements = tmp_path / "requirements.txt"
    requirements.write_text("")
    for words in environment.commands(
        environment.base_python(), tmp_path / "venv", requirements, "Darwin", False
    ):
        started = process.Process(words)
        while started.returncode is None:
            started.messages()
        assert started.returncode == 0, started.last_lines()
    assert environment.python_in(tmp_path / "venv").is_file()


def test_the_environment_is_stripped(monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    monkeypatch.setenv("OTHER", "kept")
    clean = process.clean_environment()
    assert "PYTHONHOME" not in clean and clean["OTHER"] == "kept"


def test_the_backend_is_checked(addon, standin, monkeypatch):
    assert bpy.ops.dantew.check_python() == {"FINISHED"}
    assert not bpy.ops.dantew.check_python.poll(), "one at a time"
    while job.tick() is not None:
        pass
    assert (job.task.state, job.task.lines) == ("done", ["stand-in: no torch"])
    monkeypatch.setenv("DANTEW_BACKEND_PYTHON", __file__)  # a file, but no program
    bpy.ops.dantew.check_python()
    while job.tick() is not None:
        pass
    assert job.task.state == "failed" and __file__ in job.task.lines[0]
