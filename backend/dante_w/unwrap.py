"""New UVs for a mesh that has none, by xatlas.

xatlas is slow, cannot be interrupted, holds Python's lock all the while and reports nothing, so it runs in
a child process: this one stays able to report, and to be cancelled.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dante_w.errors import BadInput, OutOfRoom
from dante_w.mesh import Mesh

PADDING = 4  #: texels between charts
_FACES_PER_SECOND = 3000.0  #: measured on one core; only the progress shown depends on it
_BEAT = 0.25  #: seconds between reports

_CHILD = """
import sys
import numpy as np
import xatlas
folder, size, padding = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
atlas = xatlas.Atlas()
atlas.add_mesh(np.load(folder + "/vertices.npy"), np.load(folder + "/faces.npy"))
pack = xatlas.PackOptions()
pack.padding, pack.resolution, pack.bilinear = padding, size, True
atlas.generate(xatlas.ChartOptions(), pack)
_, corners, uvs = atlas.get_mesh(0)
uvs = uvs * np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height, 1)
np.save(folder + "/uvs.npy", uvs[corners])
np.save(folder + "/atlases.npy", atlas.atlas_count)
"""


def unwrap(mesh: Mesh, progress: Callable[[float], None], size: int = 2048) -> Mesh:
    """The same vertices and faces, in the same order, with new UVs in [0, 1]; old UVs are ignored.

    Faces without area get UVs (0, 0). Charts lie about 4 texels apart in a texture of `size` texels.

    Args:
        progress: called a few times a second with the fraction done, a guess from the number of faces. What
            it raises ends the work and passes through.

    Raises:
        BadInput: xatlas could not unwrap the mesh.
        OutOfRoom: there was no room for its files, or the child ran out of memory.
    """
    with tempfile.TemporaryDirectory(prefix="dante-w-unwrap-") as folder:
        try:
            np.save(Path(folder) / "vertices.npy", _unit_cube(mesh.vertices))
            np.save(Path(folder) / "faces.npy", mesh.faces.astype(np.uint32))
        except OSError as error:
            raise OutOfRoom(f"{folder}: no room to unwrap in; free some disk space.") from error
        _run_child(folder, size, progress, len(mesh.faces) / _FACES_PER_SECOND)
        uvs = np.load(Path(folder) / "uvs.npy").astype(np.float64)
        atlases = int(np.load(Path(folder) / "atlases.npy"))
    if uvs.shape != (len(mesh.faces), 3, 2) or not np.isfinite(uvs).all() or atlases != 1:
        raise BadInput("the mesh could not be unwrapped onto one texture; unwrap it in Blender.")
    progress(1.0)
    return Mesh(mesh.vertices, mesh.faces, uvs)


def _unit_cube(vertices: np.ndarray) -> np.ndarray:
    """Float32 vertices moved and scaled to [0, 1], so that no digits are lost far from the origin."""
    low = vertices.min(axis=0)
    extent = float((vertices - low).max())
    return ((vertices - low) / (extent or 1.0)).astype(np.float32)


def _run_child(folder: str, size: int, progress: Callable[[float], None], expected: float) -> None:
    command = [sys.executable, "-I", "-c", _CHILD, folder, str(size), str(PADDING)]
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    began = time.monotonic()
    try:
        while child.poll() is None:
            share = (time.monotonic() - began) / max(expected, 1e-3)
            progress(share / (1.0 + share))  # never done before it is
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(_BEAT)
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
    if child.returncode == -9:  # killed by the system
        raise OutOfRoom("memory ran out while unwrapping; decimate the mesh or unwrap it in Blender.")
    if child.returncode != 0:
        raise BadInput("the mesh could not be unwrapped (xatlas failed); unwrap it in Blender.")
