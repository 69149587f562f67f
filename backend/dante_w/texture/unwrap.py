"""New UVs for a mesh that has none, by xatlas.

xatlas is slow, cannot be interrupted, holds Python's lock all the while and reports nothing, so it runs in
a child process: this one stays able to report, and to be cancelled.
"""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.scene.mesh import Mesh


@dataclass(frozen=True)
class UnwrapSettings:
    """How charts are packed, and how progress is reported."""

    #: Texels between charts: room for the border that bilinear lookups read, on either side.
    padding: int = 4
    #: Faces that xatlas unwraps in a second on one core; only the progress shown depends on it.
    faces_per_second: float = 3000.0
    #: Seconds between reports of progress.
    interval: float = 0.25


UNWRAP = UnwrapSettings()

#: Reads the arrays from stdin, writes their UVs to stdout. It must not outlive the backend, which may leave
#: in the middle of this, nor wait for xatlas when Ctrl-C is pressed.
_CHILD = """
import ctypes
import io
import signal
import sys
import numpy as np
import xatlas
signal.signal(signal.SIGINT, signal.SIG_DFL)
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
size, padding = int(sys.argv[1]), int(sys.argv[2])
arrays = io.BytesIO(sys.stdin.buffer.read())
vertices, faces = np.load(arrays), np.load(arrays)
atlas = xatlas.Atlas()
atlas.add_mesh(vertices, faces)
pack = xatlas.PackOptions()
pack.padding, pack.resolution, pack.bilinear = padding, size, True
atlas.generate(xatlas.ChartOptions(), pack)
_, corners, uvs = atlas.get_mesh(0)
if atlas.atlas_count != 1:
    sys.exit("the charts do not fit one texture")
uvs = uvs * (np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height))
result = io.BytesIO()
np.save(result, uvs[corners].astype(np.float64))
sys.stdout.buffer.write(result.getvalue())
"""


def unwrap(
    mesh: Mesh, progress: Callable[[float], None], size: int = 2048, settings: UnwrapSettings = UNWRAP
) -> Mesh:
    """The same vertices and faces, in the same order, with new UVs in [0, 1]; old UVs are ignored.

    Faces without area get UVs (0, 0). Charts lie about `padding` texels apart in a texture of `size` texels a side.

    Args:
        progress: called a few times a second with the fraction done, a guess from the number of faces. What
            it raises ends the work and passes through.

    Raises:
        BadInput: xatlas could not unwrap the mesh.
        OutOfRoom: the child ran out of memory.
    """
    arrays = io.BytesIO()
    np.save(arrays, _unit_cube(mesh.vertices))
    np.save(arrays, mesh.faces.astype(np.uint32))
    expected = len(mesh.faces) / settings.faces_per_second
    result = _run_child(arrays.getvalue(), size, progress, expected, settings)
    uvs = np.load(io.BytesIO(result))
    if uvs.shape != (len(mesh.faces), 3, 2) or not np.isfinite(uvs).all():
        raise BadInput("the mesh could not be unwrapped (xatlas left faces out); unwrap it in Blender.")
    progress(1.0)
    return replace(mesh, uvs=uvs)


def _unit_cube(vertices: np.ndarray) -> np.ndarray:
    """Float32 vertices moved and scaled to [0, 1], so that no digits are lost far from the origin."""
    low = vertices.min(axis=0)
    extent = float((vertices - low).max())
    return ((vertices - low) / (extent or 1.0)).astype(np.float32)


def _run_child(
    data: bytes | None,
    size: int,
    progress: Callable[[float], None],
    expected: float,
    settings: UnwrapSettings,
) -> bytes:
    """What the child writes; `expected` seconds from now, about."""
    child = subprocess.Popen(
        [sys.executable, "-I", "-c", _CHILD, str(size), str(settings.padding)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    start = time.monotonic()
    result: bytes | None = None
    try:
        while result is None:
            share = (time.monotonic() - start) / max(expected, 1e-3)
            progress(share / (1.0 + share))  # never done before it is
            with contextlib.suppress(subprocess.TimeoutExpired):
                result, _ = child.communicate(data, timeout=settings.interval)
            data = None  # communicate remembers it
    finally:
        if child.poll() is None:
            child.kill()
            child.communicate()
    if child.returncode == -9:  # killed by the system
        raise OutOfRoom("memory ran out while unwrapping; decimate the mesh or unwrap it in Blender.")
    if child.returncode != 0:
        raise BadInput("the mesh could not be unwrapped (xatlas failed); unwrap it in Blender.")
    return result
