"""The one recovery and the one set-up task that may run at a time, and the timer that watches them."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from pathlib import Path

import bpy

from .recovery import Recovery
from .task import Task

#: Seconds between two looks at what runs, and while something is being stopped.
TICK, QUICK_TICK = 0.25, 0.05

recovery: Recovery | None = None
task: Task | None = None


def recovering() -> bool:
    """Whether a recovery is running."""
    return recovery is not None and recovery.state == "running"


def setting_up() -> bool:
    """Whether a set-up task is running."""
    return task is not None and task.state == "running"


def start_recovery(command: list[str], obj: bpy.types.Object, out: Path, pack: bool) -> None:
    """Start the backend for `obj`; raises OSError where it cannot be started."""
    global recovery
    recovery = Recovery.start(command, obj, out, pack)
    _watch()


def start_task(title: str, commands: list[list[str]], when_done: Callable[[], None] = lambda: None) -> None:
    """Start a set-up task; `when_done` is called when all its commands ended well."""
    global task
    task = Task(title, commands, when_done)
    _watch()


def tick() -> float | None:
    """Timer: look at what runs and redraw the panel; ends itself when nothing does."""
    works = [work for work in (recovery, task) if work is not None and work.state == "running"]
    works = [work for work in works if work.update()]
    redraw()
    if not works:
        return None
    stopping = any(work.process is not None and work.process.cancelled for work in works)
    return QUICK_TICK if stopping else TICK


def stop() -> None:
    """End everything that runs and wait for it: the file is closed, Blender quits, or the add-on is turned off."""
    global recovery, task
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    processes = [work.process for work in (recovery, task) if work is not None and work.process is not None]
    for process in processes:  # all at once, then wait for each
        process.cancel()
    for process in processes:
        process.close()
    recovery = task = None


def redraw() -> None:
    """Draw the panels again, and nothing else: redrawing the viewport would take time from the backend."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in (("VIEW_3D", "UI"), ("PREFERENCES", "WINDOW")):
                    region.tag_redraw()


def _watch() -> None:
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK)


@bpy.app.handlers.persistent
def _file_closes(*_: object) -> None:
    stop()


def register() -> None:
    """Stop the backend with the file and with Blender."""
    bpy.app.handlers.load_pre.append(_file_closes)
    atexit.register(stop)


def unregister() -> None:
    """Undo `register`, and stop."""
    stop()
    bpy.app.handlers.load_pre.remove(_file_closes)
    atexit.unregister(stop)
