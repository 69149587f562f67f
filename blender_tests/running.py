"""Helpers for tests of a running backend."""

from __future__ import annotations

import os
import time

from dante_w_addon.bridge import job
from dante_w_addon.bridge.progress import Progress


def finish(seconds: float = 20.0) -> Progress:
    """Tick as Blender's timer would, until the recovery has ended."""
    end = time.monotonic() + seconds
    while job.tick() is not None:
        assert time.monotonic() < end, "the recovery did not end"
        time.sleep(0.02)
    return job.recovery.progress


def alive(pid: int) -> bool:
    """Whether the process runs."""
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"  # a zombie has ended
    except (ProcessLookupError, FileNotFoundError):  # it may end between these lines
        return False
