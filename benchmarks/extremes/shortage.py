"""Too little disk, memory or permission. Small disks are file systems in memory, mounted for the purpose (Linux, as root)."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from extremes.provoke import MODELS, SIZE, Stand, judged, run, tried
from extremes.row import Row

#: The ray cache goes to disk, as it does when it would fill a third of the free memory.
SPILL = """
import psutil
from dante_w.rays import cast_photos
class Little: virtual_memory = staticmethod(lambda: psutil.virtual_memory()._replace(available=0))
cast_photos.psutil = Little
"""
KEEP_ALL = "from dante_w.run import checkpoints; checkpoints.SECONDS = 0.0"
#: What every library says when memory runs out, raised where it would be.
RAISE = """
import torch
from dante_w.commands import recover
def fail(*_): raise {error}
recover.recover_into = fail
"""
ERRORS = {
    "CUDA": "torch.OutOfMemoryError('CUDA out of memory. Tried to allocate 20.00 GiB.')",
    "torch, CPU": "RuntimeError('[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can not allocate memory')",
    "numpy": "__import__('numpy')._core._exceptions._ArrayMemoryError((1 << 40,), __import__('numpy').dtype('f8'))",
    "threads": "RuntimeError('can\\'t start new thread')",
    "loading": "ImportError('libtorch_cpu.so: failed to map segment from shared object')",
}


@contextlib.contextmanager
def small_disk(folder: Path, size: str, *more: str) -> Iterator[Path]:
    """A file system of its own in `folder`; raises OSError where none can be mounted."""
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(folder)], capture_output=True, check=False
    )
    if done.returncode:
        raise OSError(f"nothing can be mounted here: {done.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def rows(place: Stand, progress: Callable[[str], None]) -> Iterator[Row]:
    cases: dict[str, Callable[[str], Row]] = {}
    for size, words in (("100k", ""), ("1400k", "full"), ("3000k", "full")):
        cases[f"disk of {size} full, average, texture 1024"] = partial(
            _full, place, size, words, None, "average", "1024"
        )
    cases["disk full, ray cache in a file"] = partial(_full, place, "900k", "full", SPILL, "recover", "64")
    for model in MODELS:
        cases[f"disk full, EXR, {model}"] = partial(
            _full, place, "2200k", "disk", None, "recover", "512", "--format", "exr", *MODELS[model]
        )
    cases["checkpoints do not fit"] = partial(_no_checkpoints, place)
    cases["temporary folder full or missing, plan"] = partial(_no_temporary, place)
    cases["result on a read-only disk"] = partial(_read_only, place)
    cases["result in a folder that is a file"] = partial(_file_in_the_way, place)
    cases["a folder where albedo.png belongs"] = partial(_folder_in_the_way, place)
    for mib in (64, 512, 1024, 1500, 1660, 1700, 1750):
        for model in MODELS:
            cases[f"{mib} MiB of address space, {model}"] = partial(_little_memory, place, mib, model)
    for library, error in ERRORS.items():
        cases[f"out of memory as {library} says it"] = partial(_raised, place, error)
    for name, work in cases.items():
        progress(name)
        yield tried(name, partial(work, name))


def _full(
    place: Stand, size: str, words: str, patch: str | None, verb: str, texture: str, *options_and_name: str
) -> Row:
    *options, name = options_and_name
    with small_disk(place.folder / "disk", size) as disk:
        out = place.fresh(disk / "out")
        more = ["--preset", "draft"] if verb == "recover" else []
        found = run(verb, place.scene, "--out", out, "--texture-size", texture, *more, *options, patch=patch)
        return judged(name, 4, found, place, words, out)


def _no_checkpoints(place: Stand, name: str) -> Row:
    """They are left out, and the run ends well."""
    with small_disk(place.folder / "disk", "4m") as disk:
        out = place.fresh(disk / "out")
        arguments = ["recover", place.scene, "--out", out, "--preset", "draft", *SIZE]
        found = run(*arguments, patch=KEEP_ALL)
        left = sorted({path.name for path in out.iterdir()} - {"albedo.png", "coverage.png", "report.json"})
        told = f"exit {found.code}, {', '.join(left) or 'nothing'} left"
        return Row(name, "faults", told, "exit 0, nothing left", found.code == 0 and not left, found.sentence)


def _no_temporary(place: Stand, name: str) -> Row:
    """A plan needs a folder for a moment. With no usable one it says so; it never fills the one it has."""
    place.fresh()
    with small_disk(place.folder / "disk", "64k") as disk:
        with contextlib.suppress(OSError):
            (disk / "filler").write_bytes(bytes(1 << 20))
        patch = f"import tempfile; tempfile.tempdir = {str(disk)!r}"
        found = run("plan", place.scene, patch=patch)
        left = sorted(path.name for path in disk.iterdir())
    row = judged(name, 4, found, place, "disk")
    return row if left == ["filler"] else row._replace(holds=False, note=f"left: {left}")


def _read_only(place: Stand, name: str) -> Row:
    with small_disk(place.folder / "disk", "4m") as disk:
        out = place.fresh(disk / "out")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        found = run("average", place.scene, "--out", out, *SIZE)
        return judged(name, 2, found, place, "--out", out)


def _file_in_the_way(place: Stand, name: str) -> Row:
    place.fresh()
    file = place.folder / "file"
    file.write_text("not a folder")
    found = run("average", place.scene, "--out", file, *SIZE)
    row = judged(name, 2, found, place, "--out")
    return (
        row if file.read_text() == "not a folder" else row._replace(holds=False, note="the file has changed")
    )


def _folder_in_the_way(place: Stand, name: str) -> Row:
    out = place.fresh()
    (out / "albedo.png").unlink()
    (out / "albedo.png").mkdir()
    found = run("average", place.scene, "--out", out, *SIZE)
    good = found.code == 2 and (out / "report.json").is_file() and not list(out.glob(".partial*"))
    told = f"exit {found.code}, former report {'there' if good else 'GONE'}"
    return Row(
        name,
        "faults",
        told,
        "exit 2, one sentence, intact",
        good and "albedo.png" in found.sentence,
        place.short(found.sentence),
    )


def _little_memory(place: Stand, mib: int, model: str, name: str) -> Row:
    """Exit 4 with a sentence, or, from where it suffices, the result: never a traceback, a hang or a rest."""
    place.fresh()
    arguments = ["recover", place.scene, "--out", place.out, "--preset", "standard", "--texture-size", "2048"]
    one_thread = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    limit = ["prlimit", f"--as={mib << 20}"]
    found = run(*arguments, *MODELS[model], before=limit, **one_thread)
    if found.code == 0:
        return Row(name, "faults", "exit 0: it suffices", "exit 4 and a sentence, or 0", True)
    return judged(name, 4, found, place, "memory")


def _raised(place: Stand, error: str, name: str) -> Row:
    place.fresh()
    found = run("recover", place.scene, "--out", place.out, *SIZE, patch=RAISE.format(error=error))
    return judged(name, 4, found, place, "memory")
