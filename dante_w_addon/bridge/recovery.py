"""One recovery: the backend's process, its progress, and its result on the object."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ..blender import material, uv_back
from ..contract.report import MESH, read_report, summary
from .process import Process
from .progress import Progress


@dataclass
class Recovery:
    """A running or ended recovery. The object is remembered by name and id: undo invalidates references.

    Attributes:
        out: the result folder.
        pack: whether the result's images are kept inside the .blend.
        start_time: seconds of the monotonic clock.
    """

    process: Process
    object_name: str
    object_uid: int
    out: Path
    pack: bool
    progress: Progress = field(default_factory=Progress)
    start_time: float = field(default_factory=time.monotonic)

    @classmethod
    def start(cls, command: list[str], obj: bpy.types.Object, out: Path, pack: bool) -> Recovery:
        """Start the backend for `obj`.

        Raises:
            OSError: it cannot be started.
        """
        return cls(Process(command), obj.name, _uid(obj), out, pack)

    @property
    def state(self) -> str:
        """`running`, `done`, `failed` or `cancelled`."""
        return self.progress.state

    def find_object(self) -> bpy.types.Object | None:
        """The object the result is for, also after it was renamed."""
        for obj in bpy.data.objects:
            if self.object_uid and _uid(obj) == self.object_uid:
                return obj
        return bpy.data.objects.get(self.object_name)

    def update(self) -> bool:
        """Read what the backend wrote; put its result on the object at the end. Returns whether it still runs."""
        self.progress.follow(self.process)
        if self.state == "done":
            self._finish()
        return self.state == "running"

    def _finish(self) -> None:
        obj = self.find_object()
        if obj is None or obj.type != "MESH":
            self.progress.message = f"{self.object_name} no longer exists. Its texture is in {self.out}."
            return
        try:
            target = put_on(obj, self.out, self.pack)
        except (OSError, RuntimeError, ValueError, IndexError) as error:
            self.progress.state, self.progress.message = "failed", f"The result cannot be read: {error}"
            return
        if target != obj:
            bpy.context.view_layer.objects.active = target
            self.progress.message = (
                f"The new UVs do not fit {obj.name}, so they are on a new object: {target.name}."
            )
        _push_undo("Recover Albedo")


def put_on(obj: bpy.types.Object, out: Path, pack: bool) -> bpy.types.Object:
    """Put the result in the folder `out` on `obj`.

    Returns:
        The textured object: a new one, with `obj` hidden, where new UVs do not fit `obj`.

    Raises:
        OSError, ValueError: the folder is not a whole result.
    """
    has_new_uvs = summary(read_report(out)).unwrapped  # a mesh of an earlier run may lie beside
    target = uv_back.bring_back(obj, out / MESH) if has_new_uvs else obj
    material.apply(target, out, pack)
    if target != obj:
        obj.hide_render = True
        with contextlib.suppress(RuntimeError):  # it is in no collection of this view layer
            obj.hide_set(True)
    return target


def _uid(obj: bpy.types.Object) -> int:
    return getattr(obj, "session_uid", 0)  # not in every 4.2


def _push_undo(message: str) -> None:
    windows = bpy.context.window_manager.windows if bpy.context.window_manager else ()
    if len(windows):  # a timer has no window of its own
        with bpy.context.temp_override(window=windows[0]):
            if bpy.ops.ed.undo_push.poll():
                bpy.ops.ed.undo_push(message=message)
