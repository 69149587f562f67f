"""The backend's own environment: which Python can make one, and by which commands. Knows no bpy."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from .process import clean_environment

#: Windows refuses longer paths, and torch has files 130 characters below site-packages.
LONGEST_FOLDER = 90
TORCH_WHEELS = "https://download.pytorch.org/whl"


def torch_index(system: str, nvidia: bool) -> str | None:
    """The wheel index that has the PyTorch for a machine, or None where the default one has it.

    The default index carries CUDA builds for Linux, and CPU builds for Windows and macOS.
    """
    if system == "Linux" and not nvidia:
        return f"{TORCH_WHEELS}/cpu"
    if system == "Windows" and nvidia:
        return f"{TORCH_WHEELS}/cu130"
    return None


def has_nvidia() -> bool:
    """Whether NVIDIA's driver is installed."""
    return shutil.which("nvidia-smi") is not None or Path("/proc/driver/nvidia/version").is_file()


def python_in(venv: Path) -> Path:
    """The interpreter of a virtual environment."""
    return venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def base_python(candidates: Sequence[str | None] = ()) -> str | None:
    """A Python from 3.11 up that can make a virtual environment: Blender's own if it can; None where there is none."""
    names = [*candidates, sys.executable, shutil.which("python3"), shutil.which("python")]
    return next((name for name in names if name and _can_make_venv(name)), None)


def _can_make_venv(python: str) -> bool:
    code = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))"
    try:
        result = subprocess.run(
            [python, "-I", "-c", code],
            capture_output=True,
            env=clean_environment(),
            stdin=subprocess.DEVNULL,
            timeout=20.0,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return result.returncode == 0


def commands(
    python: str, venv: Path, requirements: Path, system: str | None = None, nvidia: bool | None = None
) -> list[list[str]]:
    """The commands that make `venv` and install the backend's pinned packages, wheels only.

    Raises:
        ValueError: the path is too long for Windows.
    """
    system = platform.system() if system is None else system
    if system == "Windows" and len(str(venv)) > LONGEST_FOLDER:
        raise ValueError(f"{venv} is too long a path for Windows; type a Python of your own instead.")
    index = torch_index(system, has_nvidia() if nvidia is None else nvidia)
    install = [str(python_in(venv)), "-I", "-m", "pip", "install", "--only-binary", ":all:"]
    install += ["--disable-pip-version-check", "--progress-bar", "off", "-r", str(requirements)]
    return [
        [python, "-I", "-m", "venv", "--clear", str(venv)],
        install + (["--extra-index-url", index] if index else []),
    ]
