"""`dante-w doctor`: what a run would use on this machine."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import psutil
import torch

from dante_w import __version__
from dante_w.field.cuda import grid as cuda_grid
from dante_w.run.device import failure, pick_device

PACKAGES = ("torch", "numpy", "numba", "OpenImageIO", "xatlas", "embreex", "pycolmap", "psutil")


def examine() -> dict[str, Any]:
    """Device, library versions and memory, as plain values."""
    memory = psutil.virtual_memory()
    device = pick_device("auto")
    found: dict[str, Any] = {
        "dante_w": __version__,
        "device": str(device),
        "cuda": failure("cuda") or torch.cuda.get_device_name(),
        "mps": failure("mps") or "works",
        "cores": os.cpu_count(),
        "memory_gib": round(memory.total / 2**30, 1),
        "free_memory_gib": round(memory.available / 2**30, 1),
    }
    if device.type == "cuda":
        free, total = torch.cuda.mem_get_info()
        found["triton"] = cuda_grid.failure() or "works"
        found.update(gpu_memory_gib=round(total / 2**30, 1), free_gpu_memory_gib=round(free / 2**30, 1))
    return found | library_versions()


def library_versions() -> dict[str, str]:
    """Versions of Python and of the pinned packages."""
    return {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
