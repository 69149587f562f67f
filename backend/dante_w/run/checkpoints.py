"""What a run has worked out so far, kept beside its result in case it is killed: `--resume` goes on from there.

A checkpoint is a folder with one `.npy` file per array and the rest as JSON; nothing is pickled. Its name appears when it is
whole. All of them belong to one state of the inputs, known by a hash, which is the owner of their folder (see `own_folders`);
they are removed when others are found, when a run starts without `--resume`, and when it ends well. Where something else has the
folder's name, the run goes on without checkpoints; a link there is removed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import shutil
import time
import types
import typing
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil
import torch

from dante_w import __version__
from dante_w.contract.scene_folder import Scene
from dante_w.options import RecoverOptions
from dante_w.run.own_folders import is_file, is_folder, make, owner, remove
from dante_w.run.result_folder import CHECKPOINTS, remove_checkpoints
from dante_w.scene.mesh import Mesh

T = TypeVar("T")
#: Work that takes less than this is done again rather than kept.
SECONDS = 20.0
_TREE = "tree.json"
#: Options that change nothing of what is worked out.
_NO_INPUT = ("out", "resume", "format", "known")


@dataclasses.dataclass
class Checkpoints:
    """The checkpoints of one run in `folder`. `resumed` names those that were used."""

    folder: Path
    key: str
    resumed: list[str] = dataclasses.field(default_factory=list)
    since: float = dataclasses.field(default_factory=time.monotonic)

    def due(self) -> bool:
        """Whether what was done since the last time is worth keeping."""
        return time.monotonic() - self.since >= SECONDS

    def done(self, name: str, kind: type[T], work: Callable[[], T]) -> T:
        """What `work` returns, a dataclass `kind`, or what it returned before the run was killed."""
        found = self.load(name, kind)
        if found is None:
            found = work()
            self.save(name, found)
        return found

    def load(self, name: str, kind: type[T]) -> T | None:
        """What was kept under `name`; None if nothing was, or nothing of use."""
        folder = self.folder / name
        if owner(self.folder) != self.key or not is_folder(folder):
            return None

        def file(file_name: str) -> Path:
            """A file of the checkpoint itself; raises ValueError."""
            path = folder / file_name
            if path.parent != folder or not is_file(path):
                raise ValueError(f"{path} is no file of the checkpoint")
            return path

        try:
            tree = json.loads(file(_TREE).read_text(encoding="utf-8"))
            large = sum(path.lstat().st_size for path in folder.iterdir())
            mode: Any = "r" if large > psutil.virtual_memory().available / 3 else None
            found: T = _unpacked(kind, tree, lambda array: np.load(file(array), mode, allow_pickle=False))
        except (OSError, ValueError, KeyError, TypeError, EOFError):
            return None
        self.resumed.append(name)
        return found

    def save(self, name: str, value: Any) -> None:
        """Keep a dataclass of arrays, numbers and further such dataclasses, if the work since the last time was worth it and
        the disk has twice the room."""
        if not self.due():
            return
        arrays: list[np.ndarray] = []
        tree = _packed(value, arrays)
        with contextlib.suppress(OSError):  # without it the run goes on just as well
            if shutil.disk_usage(self.folder.parent).free > 2 * sum(array.nbytes for array in arrays):
                self._write(name, tree, arrays)
        self.since = time.monotonic()

    def _write(self, name: str, tree: Any, arrays: list[np.ndarray]) -> None:
        if owner(self.folder) != self.key:
            make(self.folder, self.key)
        partial, whole = self.folder / f"{name}.partial", self.folder / name
        try:
            remove(partial)
            partial.mkdir()
            for number, array in enumerate(arrays):
                np.save(partial / f"{number}.npy", array, allow_pickle=False)
            (partial / _TREE).write_text(json.dumps(tree), encoding="utf-8")
            remove(whole)
            os.replace(partial, whole)
        finally:
            remove(partial)


def open_checkpoints(options: RecoverOptions, settings: object, scene: Scene, mesh: Mesh) -> Checkpoints:
    """The checkpoints of a run with these options and settings (frozen dataclasses), from these files; none yet unless it resumes one
    just like it."""
    assert options.out is not None  # a plan alone keeps nothing
    folder, key = options.out / CHECKPOINTS, _key(options, settings, scene, mesh)
    if not options.resume or owner(folder) != key:
        remove_checkpoints(options.out)
    return Checkpoints(folder, key)


def _key(options: RecoverOptions, settings: object, scene: Scene, mesh: Mesh) -> str:
    """A hash of the version, the options, the settings, the poses, the mesh, and the photos' paths, sizes and times."""
    chosen = {name: str(value) for name, value in sorted(vars(options).items()) if name not in _NO_INPUT}
    files: Iterable[Path | None] = (
        file for frame in scene.frames for file in (frame.image, frame.mask, frame.albedo)
    )
    poses = [[str(frame.camera), frame.camera_to_world.tolist()] for frame in scene.frames]
    stamps = [
        [str(file), file.stat().st_size, file.stat().st_mtime_ns]
        for file in files
        if file is not None and file.is_file()
    ]
    told = hashlib.sha256(json.dumps([__version__, chosen, repr(settings), poses, stamps]).encode())
    for array in (mesh.vertices, mesh.faces, mesh.uvs, mesh.normals):
        told.update(np.ascontiguousarray(() if array is None else array).data)
    return told.hexdigest()


def _packed(value: Any, arrays: list[np.ndarray]) -> Any:
    """`value` as JSON has it; arrays are put into `arrays` and named by their file."""
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"file": f"{len(arrays) - 1}.npy"}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: _packed(getattr(value, field.name), arrays) for field in dataclasses.fields(value)
        }
    if isinstance(value, dict):
        return {name: _packed(each, arrays) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_packed(each, arrays) for each in value]
    return value.item() if isinstance(value, np.generic) else value


def _unpacked(kind: Any, tree: Any, read: Callable[[str], np.ndarray]) -> Any:
    """The reverse of `_packed` for a value of type `kind`."""
    if isinstance(kind, types.UnionType):
        kind = next(each for each in typing.get_args(kind) if each is not types.NoneType)
    if tree is None:
        return None
    if kind is np.ndarray:
        return read(tree["file"])
    if kind is torch.Tensor:
        return torch.from_numpy(read(tree["file"]))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        return kind(**{name: _unpacked(hints[name], each, read) for name, each in tree.items()})
    inner = typing.get_args(kind)
    if typing.get_origin(kind) is dict:
        return {name: _unpacked(inner[1], each, read) for name, each in tree.items()}
    if typing.get_origin(kind) in (list, tuple):
        return typing.get_origin(kind)(_unpacked(inner[0], each, read) for each in tree)
    return tree
