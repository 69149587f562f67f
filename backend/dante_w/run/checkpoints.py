"""What a run has worked out so far, kept beside its result in case it is killed: `--resume` goes on from there.

A checkpoint is a folder with one `.npy` file per array and the rest as JSON; nothing is pickled. Its name appears when it is
whole. All of them belong to one state of the inputs, told by a hash; they are removed when others are found, when a run
starts without `--resume`, and when it ends well.
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
from dante_w.run.result_folder import CHECKPOINTS
from dante_w.scene.mesh import Mesh

T = TypeVar("T")
#: Work that takes less than this is done again rather than kept.
SECONDS = 20.0
_KEY, _TREE = "inputs.txt", "tree.json"
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
        try:
            tree = json.loads((folder / _TREE).read_text(encoding="utf-8"))
            large = sum(file.stat().st_size for file in folder.iterdir())
            mode: Any = "r" if large > psutil.virtual_memory().available / 3 else None
            found: T = _unpacked(kind, tree, lambda file: np.load(folder / file, mode, allow_pickle=False))
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
        partial, whole = self.folder / f"{name}.partial", self.folder / name
        with contextlib.suppress(OSError):  # without it the run goes on just as well
            if shutil.disk_usage(self.folder.parent).free > 2 * sum(array.nbytes for array in arrays):
                self.folder.mkdir(exist_ok=True)
                (self.folder / _KEY).write_text(self.key)
                partial.mkdir()
                for number, array in enumerate(arrays):
                    np.save(partial / f"{number}.npy", array, allow_pickle=False)
                (partial / _TREE).write_text(json.dumps(tree), encoding="utf-8")
                shutil.rmtree(whole, ignore_errors=True)
                os.replace(partial, whole)
        shutil.rmtree(partial, ignore_errors=True)
        self.since = time.monotonic()


def open_checkpoints(options: RecoverOptions, scene: Scene, mesh: Mesh) -> Checkpoints:
    """The checkpoints of a run with these options, from these files; none yet unless it resumes one just like it."""
    assert options.out is not None  # a plan alone keeps nothing
    folder = options.out / CHECKPOINTS
    key = _key(options, scene, mesh)
    found = (folder / _KEY).read_bytes() if (folder / _KEY).is_file() else b""
    old = folder.glob("*.partial") if options.resume and found == key.encode() else [folder]
    for each in old:
        shutil.rmtree(each, ignore_errors=True)
    return Checkpoints(folder, key)


def _key(options: RecoverOptions, scene: Scene, mesh: Mesh) -> str:
    """A hash of the version, the options, the poses, the mesh, and the photos' paths, sizes and times."""
    settings = {name: str(value) for name, value in sorted(vars(options).items()) if name not in _NO_INPUT}
    files: Iterable[Path | None] = (
        file for frame in scene.frames for file in (frame.image, frame.mask, frame.albedo)
    )
    poses = [[str(frame.camera), frame.camera_to_world.tolist()] for frame in scene.frames]
    stamps = [
        [str(file), file.stat().st_size, file.stat().st_mtime_ns]
        for file in files
        if file is not None and file.is_file()
    ]
    told = hashlib.sha256(json.dumps([__version__, settings, poses, stamps]).encode())
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
