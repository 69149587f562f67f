import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from dante_w.contract.errors import BadInput, OutOfRoom
from dante_w.scene.mesh import Mesh
from dante_w.texture import unwrap as module
from dante_w.texture.unwrap import UNWRAP, unwrap


def cube(offset: float = 0.0) -> Mesh:
    """A cube of 12 triangles, with a triangle without area among them."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) + offset
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [triangle for a, b, c, d in quads for triangle in ([a, b, c], [a, c, d])]
    faces.insert(5, [3, 3, 7])
    return Mesh(vertices, np.array(faces, np.int32), None)


def doubled_areas(corners: np.ndarray) -> np.ndarray:
    (a, b), (c, d) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.abs(a * d - b * c)


def owners(uvs: np.ndarray, size: int) -> np.ndarray:
    """Which triangle covers each texel centre, -1 for none; fails where two do."""
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size)
    owner = np.full((size, size), -1)
    for number, (a, b, c) in enumerate(uvs):
        sides = [(q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside = np.all(np.stack(sides) > 1e-9, axis=0) | np.all(np.stack(sides) < -1e-9, axis=0)
        assert (owner[inside] == -1).all()
        owner[inside] = number
    return owner


@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_a_cube(offset):
    mesh, reports = cube(offset), []
    got = unwrap(mesh, reports.append, 128)
    assert got.vertices is mesh.vertices and got.faces is mesh.faces
    assert got.uvs.shape == (13, 3, 2) and got.uvs.dtype == np.float64
    assert got.uvs.min() >= 0.0 and got.uvs.max() <= 1.0
    areas = doubled_areas(got.uvs)
    assert areas[5] == 0.0
    areas = np.delete(areas, 5)
    np.testing.assert_allclose(areas, areas[0], rtol=0.01)  # equal faces get equal area: nothing is stretched
    assert areas.sum() / 2 > 0.25  # of the texture
    assert reports == sorted(reports) and 0.0 <= reports[0] < 1.0 and reports[-1] == 1.0
    owner = owners(got.uvs, 128)
    assert len(np.unique(owner)) == 13  # 12 faces and nothing


def test_charts_keep_their_distance():
    size = 128
    uvs = unwrap(cube(), lambda share: None, size).uvs
    owner = owners(uvs, size)
    corners = {tuple(corner) for face in uvs for corner in face}
    groups = {face: {face} for face in range(len(uvs))}  # faces that share an edge in the texture
    for i in range(len(uvs)):
        for j in range(i):
            if len({tuple(c) for c in uvs[i]} & {tuple(c) for c in uvs[j]}) >= 2:
                joined = groups[i] | groups[j]
                for face in joined:
                    groups[face] = joined
    assert len(corners) > 8  # it was cut
    chart = np.array([min(groups[face]) for face in range(len(uvs))] + [-1])[owner]
    near = UNWRAP.padding - 1
    for row, column in zip(*np.nonzero(chart >= 0), strict=True):
        window = chart[max(row - near, 0) : row + near + 1, max(column - near, 0) : column + near + 1]
        assert set(np.unique(window)) <= {-1, chart[row, column]}


def test_it_can_be_stopped():
    class StopError(Exception):
        pass

    def stop(share: float) -> None:
        raise StopError

    began = time.monotonic()
    with pytest.raises(StopError):
        unwrap(cube(), stop, 64)
    assert time.monotonic() - began < 5.0


def test_failures_have_a_sentence(monkeypatch):
    monkeypatch.setattr(module, "_CHILD", "raise SystemExit(1)")
    with pytest.raises(BadInput, match="unwrap it in Blender"):
        unwrap(cube(), lambda share: None, 64)
    monkeypatch.setattr(module, "_CHILD", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    with pytest.raises(OutOfRoom, match="memory"):
        unwrap(cube(), lambda share: None, 64)


@pytest.mark.skipif(sys.platform != "linux", reason="the child is tied to its parent on Linux alone")
def test_the_child_dies_with_its_parent(tmp_path):
    slow = module._CHILD.replace("atlas = xatlas", "import time; time.sleep(60); atlas = xatlas", 1)
    assert "time.sleep" in slow
    script = (
        "import os, threading, time\n"
        "from dante_w.texture import unwrap\n"
        "from test_unwrap import cube\n"
        f"unwrap._CHILD = {slow!r}\n"
        "threading.Thread(target=unwrap.unwrap, args=(cube(), lambda share: None, 64), daemon=True).start()\n"
        "time.sleep(1.5)\n"
        "children = open(f'/proc/{os.getpid()}/task/{threading.enumerate()[-1].native_id}/children').read().split()\n"
        "print(*children, flush=True)\n"
        "os._exit(3)\n"
    )
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(module.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": paths},
        timeout=30,
    )
    (child,) = done.stdout.split()
    for _ in range(50):
        if not Path(f"/proc/{child}").exists() or " Z " in Path(f"/proc/{child}/stat").read_text():
            return
        time.sleep(0.1)
    raise AssertionError("the child lives on")
