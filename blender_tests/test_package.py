"""The zip: reproducible, valid by Blender's own validator, and at work once installed."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest
from conftest import HERE, ROOT

sys.path.insert(0, str(ROOT))
import build_addon

EXTENSION_TOOL = (
    Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return build_addon.build(tmp_path_factory.mktemp("dist"))


def test_same_sources_same_bytes(package, tmp_path):
    copy = tmp_path / "copy"
    skip = shutil.ignore_patterns("__pycache__", ".*")
    for folder in ("dante_w_addon", "backend"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=skip)
    for name in ("manifest.toml", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    for path in copy.rglob("*"):
        os.utime(path, (1e9, 1e9))
        path.chmod(0o755)
    assert build_addon.build(tmp_path / "dist", copy).read_bytes() == package.read_bytes()


def test_versions_must_agree(tmp_path):
    (tmp_path / "backend" / "dante_w").mkdir(parents=True)
    (tmp_path / "backend" / "dante_w" / "__init__.py").write_text('__version__ = "9.9.9"\n')
    shutil.copy(ROOT / "manifest.toml", tmp_path)
    with pytest.raises(ValueError, match="has version"):
        build_addon.contents(tmp_path)


def test_pure_python_with_the_backend_inside(package):
    with zipfile.ZipFile(package) as archive:
        names = archive.namelist()
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert {"__init__.py", "batch.py", "backend/launch.py", "backend/requirements.txt"} <= set(names)
    assert "backend/dante_w/contract/scene_folder.py" in names
    assert {f"backend/dante_w/estimate/{name}.json" for name in ("seconds", "quality")} <= set(names)
    assert {Path(name).suffix for name in names} <= {".py", ".json", ".toml", ".txt", ""}
    assert manifest["blender_version_min"] == "4.2.0" and set(manifest["permissions"]) == {"files", "network"}
    assert package.name == f"dante_w-{manifest['version']}.zip"


def test_blenders_validator_accepts_it(package):
    words = [sys.executable, str(EXTENSION_TOOL), "validate", str(package)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


INSTALL = """
import sys, bpy
bpy.ops.wm.read_factory_settings()
bpy.ops.extensions.package_install_files(
    filepath=sys.argv[1], repo="user_default", enable_on_install=True, overwrite=True)
assert "bl_ext.user_default.dante_w" in bpy.context.preferences.addons, "not enabled"
import bl_ext.user_default.dante_w as addon
from bl_ext.user_default.dante_w import layout
from bl_ext.user_default.dante_w.bridge import interpreter
from pathlib import Path
assert layout.backend_folder().parent == layout.FOLDER, layout.backend_folder()
assert interpreter.environment_folder().is_relative_to(Path(bpy.utils.resource_path("USER")))
venv = interpreter.environment_folder()
python = interpreter.environment.python_in(venv)
python.parent.mkdir(parents=True)
python.write_text("")
assert interpreter.backend_python() is None, "half an environment is none"
(venv / interpreter.READY).write_text("")
print("environment", python)
assert interpreter.backend_python() == str(python)
preferences_of = bpy.context.preferences.addons["bl_ext.user_default.dante_w"].preferences
preferences_of.python = sys.executable
assert interpreter.backend_python() == sys.executable
bpy.context.preferences.system.use_online_access = False
assert not bpy.ops.dantew.make_environment.poll(), "set-up must need online access"
layout.launcher = lambda: Path(sys.argv[2])
bpy.ops.wm.open_mainfile(filepath=sys.argv[3])
import time
from bl_ext.user_default.dante_w.bridge import job
assert bpy.ops.dantew.recover() == {"FINISHED"}
while job.tick() is not None:
    time.sleep(0.05)
assert job.recovery.progress.state == "done", job.recovery.progress.message
print("textured with", bpy.data.objects["Cube"].active_material.name)
print(layout.FOLDER)
"""


def test_installed_it_runs(package, scene, tmp_path):
    (tmp_path / "user" / "config").mkdir(parents=True)
    env = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    env.pop("DANTEW_BACKEND_PYTHON", None)
    standin = str(HERE / "standin" / "launch.py")
    words = [sys.executable, "-c", INSTALL, str(package), standin, bpy.data.filepath]
    done = subprocess.run(words, capture_output=True, text=True, env=env, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "textured with Cube albedo" in done.stdout
    # batch.py of the installed extension finds the environment that was made there, here an empty file.
    made = next(line for line in done.stdout.splitlines() if line.startswith("environment ")).split(" ", 1)[1]
    batch = Path(done.stdout.strip().splitlines()[-1]) / "batch.py"
    words = [sys.executable, str(batch), bpy.data.filepath, "--out", str(tmp_path / "o"), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, env=env, cwd=tmp_path, check=False)
    assert done.returncode == 2, done.stdout + done.stderr
    assert f"{made} cannot be started" in json.loads(done.stdout.splitlines()[-1])["message"]
