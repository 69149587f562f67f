"""The one recovery that may run at a time, and the one set-up task; the panel draws from them."""

from __future__ import annotations

import atexit
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from .process import Process, Progress
from .result import take_in

TICK = 0.25  # seconds between looks at the backend


@dataclass
class Recovery:
    """A running or ended recovery. The object is remembered by name and id: undo invalidates references."""

    process: Process
    object_name: str
    object_uid: int
    out: Path
    pack: bool
    progress: Progress = field(default_factory=Progress)
    started: float = field(default_factory=time.monotonic)

    def find_object(self) -> bpy.types.Object | None:
        """The object the result is for, also after it was renamed."""
        for obj in bpy.data.objects:
            if self.object_uid and _uid(obj) == self.object_uid:
                return obj
        return bpy.data.objects.get(self.object_name)

    def look(self) -> bool:
        """Take in what the backend said; put its result on the object at the end. Returns: still running."""
        self.progress.follow(self.process)
        if self.progress.state == "done":
            self._finish()
        return self.progress.state == "running"

    def _finish(self) -> None:
        obj = self.find_object()
        if obj is None or obj.type != "MESH":
            self.progress.message = f"{self.object_name} is gone; its texture is in {self.out}."
            return
        try:
            textured = take_in(obj, self.out, self.pack)
            if textured != obj:
                bpy.context.view_layer.objects.active = textured
                self.progress.message = f"The new UVs do not fit {obj.name}; {textured.name} has them."
        except (OSError, RuntimeError, ValueError, IndexError) as error:
            self.progress.state, self.progress.message = "failed", f"The result cannot be read: {error}"
            return
        _push_undo("Recover Albedo")


@dataclass
class Task:
    """Commands run one after the other, for the set-up: the last line said, and how it ended."""

    title: str
    commands: list[list[str]]
    then: Callable[[], None] = lambda: None
    process: Process | None = None
    state: str = "running"  # running, done, failed, stopped
    lines: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)

    def look(self) -> bool:
        """Start the next command when one ends well. Returns: still running."""
        if self.process is not None:
            code = self.process.returncode
            self.lines = self.process.last_lines(12)
            if code is None:
                return True
            if code != 0 or self.process.cancelled:
                self.state = "stopped" if self.process.cancelled else "failed"
                return False
        if not self.commands:
            self.state = "done"
            self.then()
            return False
        try:
            self.process = Process(self.commands.pop(0))
        except OSError as error:
            self.state, self.lines = "failed", [str(error)]
            return False
        return True


recovery: Recovery | None = None
task: Task | None = None


def recovering() -> bool:
    """Whether a recovery is running."""
    return recovery is not None and recovery.progress.state == "running"


def setting_up() -> bool:
    """Whether a set-up task is running."""
    return task is not None and task.state == "running"


def start_recovery(command: Sequence[str], obj: bpy.types.Object, out: Path, pack: bool) -> None:
    """Start the backend for `obj`; raises OSError where it cannot be started."""
    global recovery
    recovery = Recovery(Process(command), obj.name, _uid(obj), out, pack)
    _watch()


def start_task(title: str, commands: list[list[str]], then: Callable[[], None] = lambda: None) -> None:
    """Start a set-up task; `then` is called when all its commands ended well."""
    global task
    task = Task(title, commands, then)
    _watch()


def tick() -> float | None:
    """Timer: look at what runs and redraw the panel; ends itself when nothing does."""
    running = [work.look() for work in (recovery, task) if work is not None and _state(work) == "running"]
    redraw()
    return TICK if any(running) else None


def stop() -> None:
    """End everything that runs, now: the file is closed, Blender quits, or the add-on is turned off."""
    global recovery, task
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    for work in (recovery, task):
        if work is not None and work.process is not None and work.process.returncode is None:
            work.process.kill()
    recovery = task = None


def redraw() -> None:
    """Draw the panels again, and nothing else: redrawing the viewport would take time from the backend."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in (("VIEW_3D", "UI"), ("PREFERENCES", "WINDOW")):
                    region.tag_redraw()


def _uid(obj: bpy.types.Object) -> int:
    return getattr(obj, "session_uid", 0)  # not in every 4.2


def _state(work: Recovery | Task) -> str:
    return work.progress.state if isinstance(work, Recovery) else work.state


def _watch() -> None:
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK)


def _push_undo(message: str) -> None:
    windows = bpy.context.window_manager.windows if bpy.context.window_manager else ()
    if len(windows):  # a timer has no window of its own
        with bpy.context.temp_override(window=windows[0]):
            if bpy.ops.ed.undo_push.poll():
                bpy.ops.ed.undo_push(message=message)


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
