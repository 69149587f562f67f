"""Damaged and made-up files for every reader: a reader returns something valid or raises `BadInput`, within seconds.

Valid files are changed by a seeded generator (bytes, cuts, repeats, swapped numbers and words, parts of other files), or made up
from the words of their format. Inputs are read in processes of their own, `AT_ONCE` each, so that a library that aborts is seen
as what it is. By itself: `python fuzz.py READER FIRST END` prints the verdict on these inputs as one JSON object.
"""

from __future__ import annotations

import json
import random
import re
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from dante_w.contract.errors import DanteError
from dante_w.contract.scene_folder import Camera, read_scene
from dante_w.scene.cameras import check_camera, directions, project
from dante_w.scene.colmap import read_colmap
from dante_w.scene.mesh import read_mesh

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from extremes.row import Row

#: Inputs for each reader, and how many one process reads. An input may take `SECONDS`.
INPUTS, AT_ONCE, SECONDS = 20_000, 5_000, 10.0
NUMBERS = "0 1 -1 2 255 65536 2147483648 -2147483649 4294967295 9223372036854775807 1e308 1e400 -1e-320 nan inf -inf 0x10 1_0 .5 ٣"
OBJ = b"v 0 0 0\nv 1 0 0\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/1/1\nf -1/-1 -2/-2 1/1\n"
PLY = (
    b"ply\nformat %s 1.0\ncomment made\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    b"property float s\nproperty float t\nproperty float nx\nproperty float ny\nproperty float nz\nelement face 2\nproperty list uchar int vertex_indices\n"
    b"property list uchar float texcoord\nend_header\n"
)
CORNERS = [(0, 0, 0, 0, 0), (1, 0, 0, 1, 0), (1, 1, 0, 1, 1), (0, 1, 0, 0, 1)]
NORMAL = (0, 0, 1)
MODELS = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
    "INVALID",
    "X",
]


def ply_ascii() -> bytes:
    rows = [" ".join(map(str, corner + NORMAL)) for corner in CORNERS]
    return (PLY % b"ascii") + ("\n".join([*rows, "3 0 1 2 6 0 0 1 0 1 1", "3 0 2 3 0"]) + "\n").encode()


def ply_binary(order: str = "<") -> bytes:
    name = b"binary_little_endian" if order == "<" else b"binary_big_endian"
    rows = b"".join(struct.pack(order + "8f", *corner, *NORMAL) for corner in CORNERS)
    faces = struct.pack(order + "B3iB6f", 3, 0, 1, 2, 6, 0, 0, 1, 0, 1, 1) + struct.pack(
        order + "B3iB", 3, 0, 2, 3, 0
    )
    return (PLY % name) + rows + faces


def glb() -> bytes:
    positions = np.array([corner[:3] for corner in CORNERS], "<f4").tobytes()
    uvs, faces = (
        np.array([c[3:] for c in CORNERS], "<f4").tobytes(),
        np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes(),
    )
    lengths = [len(positions), len(uvs), len(faces)]
    views = [{"buffer": 0, "byteOffset": sum(lengths[:i]), "byteLength": n} for i, n in enumerate(lengths)]
    shapes = [(5126, "VEC3", 4), (5126, "VEC2", 4), (5123, "SCALAR", 6)]
    accessors = [
        {"bufferView": i, "componentType": kind, "type": shape, "count": count}
        for i, (kind, shape, count) in enumerate(shapes)
    ]
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 0}, "indices": 2, "mode": 4}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "rotation": [0, 0, 0, 1]}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": sum(lengths)}],
    }
    return pack_glb(json.dumps(document).encode(), positions + uvs + faces)


def pack_glb(text: bytes, binary: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def transforms() -> bytes:
    pose = np.eye(4).tolist()
    shared = {
        "w": 8,
        "h": 6,
        "fl_x": 9.0,
        "fl_y": 9.0,
        "cx": 4.0,
        "cy": 3.0,
        "k1": 0.01,
        "mesh_path": "mesh.obj",
    }
    frames: list[dict[str, Any]] = [
        {"file_path": "a.png", "mask_path": "m/a.png", "albedo_path": "p/a.png", "transform_matrix": pose},
        {"file_path": "b", "transform_matrix": pose[:3], "camera_model": "OPENCV_FISHEYE", "k4": 0.1},
        {"file_path": "c.jpg", "transform_matrix": pose, "camera_model": "FOV", "params": [9, 9, 4, 3, 0.5]},
    ]
    return json.dumps({**shared, "frames": frames}).encode()


def colmap_text() -> dict[str, bytes]:
    cameras = b"# cameras\n1 PINHOLE 8 6 9 9 4 3\n2 OPENCV 8 6 9 9 4 3 0.1 0 0 0\n3 SIMPLE_RADIAL_FISHEYE 8 6 9 4 3 0.1\n"
    images = b"# images\n1 1 0 0 0 0 0 0 1 a.png\n1.5 2.5 -1\n2 0.7 0.7 0 0 1 2 3 2 sub/b c.png\n\n3 0 1 0 0 0 0 1 3 c.png\n\n"
    return {"cameras.txt": cameras, "images.txt": images}


def colmap_binary() -> dict[str, bytes]:
    cameras = struct.pack("<Q", 2) + struct.pack("<IiQQ4d", 1, 1, 8, 6, 9, 9, 4, 3)
    cameras += struct.pack("<IiQQ8d", 2, 4, 8, 6, 9, 9, 4, 3, 0.1, 0, 0, 0)
    images = struct.pack("<Q", 2) + struct.pack("<I7dI", 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0"
    images += struct.pack("<Q", 1) + struct.pack("<ddQ", 1.0, 2.0, 7)
    images += struct.pack("<I7dI", 2, 0, 1, 0, 0, 1, 2, 3, 2) + b"b.png\0" + struct.pack("<Q", 0)
    return {"cameras.bin": cameras, "images.bin": images}


def damaged(content: bytes, rng: random.Random) -> bytes:
    """`content` after one to four changes of a kind each."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        data, place = bytearray(content), rng.randrange(len(content) + 1)
        kind = rng.randrange(8)
        if kind == 0 and data:
            data[place % len(data)] = rng.randrange(256)
        elif kind == 1 and data:
            data[place % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 2:
            del data[place:]
        elif kind == 3:
            del data[place : place + rng.randint(1, 16)]
        elif kind == 4:
            data[place:place] = data[: rng.randint(1, 64)] * rng.randint(1, 4)
        elif kind == 5:  # a number in a text
            found = list(re.finditer(rb"-?\d+\.?\d*", content))
            if found:
                at = rng.choice(found)
                data[at.start() : at.end()] = rng.choice(NUMBERS.split()).encode()
        elif kind == 6:  # a number of a binary file
            kinds = {
                "<i": -1,
                "<I": 2**32 - 1,
                "<Q": 2**63,
                "<f": float("nan"),
                "<d": 1e308,
                ">I": 2**31,
                "<B": 255,
            }
            form = rng.choice(list(kinds))
            data[place : place + struct.calcsize(form)] = struct.pack(form, kinds[form])
        else:  # two words change places
            words = re.split(rb"(\s+)", content)
            i, j = rng.randrange(len(words)), rng.randrange(len(words))
            words[i], words[j] = words[j], words[i]
            data = bytearray(b"".join(words))
        content = bytes(data)
    return content


def made_up(content: bytes, rng: random.Random) -> bytes:
    """A text of the words of `content` and numbers of all kinds, in its lines' order or any."""
    lines = content.split(b"\n")
    chosen = (
        [rng.choice(lines) for _ in range(rng.randint(1, 3 * len(lines)))] if rng.random() < 0.5 else lines
    )
    numbers = [number.encode() for number in NUMBERS.split()]
    made = []
    for line in chosen:
        words = [rng.choice(numbers) if rng.random() < 0.04 else word for word in line.split(b" ")]
        made.append(b" ".join(words[: rng.randint(0, len(words))] if rng.random() < 0.03 else words))
    return b"\n".join(made)


def replaced(tree: Any, rng: random.Random) -> Any:
    """A JSON value with something else in some of its places."""
    odd: list[Any] = [
        None,
        True,
        -1,
        10**400,
        2**31,
        2**63,
        1e308,
        float("nan"),
        "",
        "x" * 999,
        "../x",
        "/etc/passwd",
        "a\0b",
        "\ud800",
        [],
        {},
        [[[]]],
        0.5,
    ]
    if rng.random() < 0.015:
        return rng.choice(odd)
    if isinstance(tree, dict):
        return {key: replaced(value, rng) for key, value in tree.items() if rng.random() > 0.008}
    if isinstance(tree, list):
        return [replaced(value, rng) for value in tree if rng.random() > 0.004]
    return tree


def json_changed(content: bytes, rng: random.Random) -> bytes:
    return json.dumps(replaced(json.loads(content), rng)).encode()


def glb_changed(content: bytes, rng: random.Random) -> bytes:
    (length,) = struct.unpack_from("<I", content, 12)
    return pack_glb(json_changed(content[20 : 20 + length], rng), content[28 + length :])


def read_mesh_file(ending: str, whole: bytes, ways: list[Callable], folder: Path, rng: random.Random) -> None:
    path = folder / f"mesh.{ending}"
    path.write_bytes(rng.choice(ways)(whole, rng))
    mesh = read_mesh(path)
    assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices), "a face leads nowhere"
    assert np.isfinite(mesh.vertices).all() and (mesh.uvs is None or np.isfinite(mesh.uvs).all()), (
        "not finite"
    )
    assert mesh.normals is None or mesh.normals.shape == (*mesh.faces.shape, 3), "a corner without a normal"


def read_transforms(folder: Path, rng: random.Random) -> None:
    content = transforms()
    way = rng.choice([damaged, json_changed, json_changed])
    (folder / "transforms.json").write_bytes(way(content, rng))
    for frame in read_scene(folder).frames:
        look_through(frame.camera, frame.camera_to_world)
        inside = [path for path in (frame.image, frame.mask, frame.albedo) if path is not None]
        assert all(path.is_relative_to(folder.resolve()) for path in inside), "a path leads out"


def read_colmap_model(kind: str, folder: Path, rng: random.Random) -> None:
    model = colmap_text() if kind == "text" else colmap_binary()
    for old in folder.glob("*.*"):
        old.unlink()
    (folder / "images").mkdir(exist_ok=True)
    spoilt = rng.choice(list(model))
    for name, content in model.items():
        way = rng.choice([damaged, made_up]) if kind == "text" else damaged
        (folder / name).write_bytes(way(content, rng) if name == spoilt else content)
    for frame in read_colmap(folder).frames:
        look_through(frame.camera, frame.camera_to_world)


def read_camera(folder: Path, rng: random.Random) -> None:
    good = [9.0, 9.0, 4.0, 3.0] + [0.01] * 12
    odd = [0.0, -1.0, 1e-320, 1e308, float("nan"), float("inf"), 1e6, -1e9, 3.0]
    count = rng.randint(0, 17) if rng.random() < 0.3 else rng.choice([3, 4, 5, 8, 12, 16])
    params = tuple(rng.choice(odd) if rng.random() < 0.05 else value for value in (good + good)[:count])
    sides = [8, 6, 640, 480, 2**20, 8, 6, 640, 480, rng.choice([0, -1, 2**31, 2**63])]
    camera = Camera(rng.choice(MODELS), rng.choice(sides), rng.choice(sides), params)
    check_camera(camera)
    look_through(camera, np.eye(4))


def look_through(camera: Camera, pose: np.ndarray) -> None:
    assert np.isfinite(pose).all(), "a pose is not finite"
    pixels = np.array([[0.5, 0.5], [4.0, 3.0], [1e9, -1e9]])
    assert directions(camera, pixels).shape == (3, 3)
    assert project(camera, pose, np.array([[0.0, 0.0, -1.0], [1.0, 2.0, 3.0]])).shape == (2, 2)


#: What reads one input, made by a generator in a folder.
READERS: dict[str, Callable[[Path, random.Random], None]] = {
    "OBJ": partial(read_mesh_file, "obj", OBJ, [damaged, made_up]),
    "PLY, ASCII": partial(read_mesh_file, "ply", ply_ascii(), [damaged, made_up]),
    "PLY, binary": partial(read_mesh_file, "ply", ply_binary(), [damaged]),
    "PLY, big-endian": partial(read_mesh_file, "ply", ply_binary(">"), [damaged]),
    "GLB": partial(read_mesh_file, "glb", glb(), [damaged, glb_changed, glb_changed]),
    "transforms.json": read_transforms,
    "COLMAP, text": partial(read_colmap_model, "text"),
    "COLMAP, binary": partial(read_colmap_model, "binary"),
    "cameras": read_camera,
}


def rows(progress: Callable[[str], None], inputs: int = INPUTS) -> Iterator[Row]:
    """A row for each reader."""
    for name in READERS:
        progress(f"fuzz: {name}")
        valid, refused, slowest, wrong = 0, 0, 0.0, []
        for first in range(0, inputs, AT_ONCE):
            verdict = judged(name, first, min(first + AT_ONCE, inputs))
            valid, refused = valid + verdict["valid"], refused + verdict["refused"]
            slowest, wrong = max(slowest, verdict["slowest"]), wrong + verdict["wrong"]
        told = f"{inputs:,} inputs: {valid:,} read, {refused:,} refused, {len(wrong)} other; slowest {slowest:.1f} s"
        bound = f"read or refused, under {SECONDS:.0f} s each"
        whole = valid + refused == inputs and slowest < SECONDS
        yield Row(f"fuzz: {name}", "faults", told, bound, whole and not wrong, "; ".join(wrong[:3]))


def judged(name: str, first: int, end: int) -> dict[str, Any]:
    """The verdict on some inputs, of a process of its own."""
    command = [sys.executable, __file__, name, str(first), str(end)]
    limit = 120.0 + 0.1 * (end - first)
    try:
        done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=limit, check=False)
        verdict: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return verdict
    except subprocess.TimeoutExpired:
        reason = f"inputs {first} to {end} took more than {limit:.0f} s"
    except (IndexError, ValueError):
        reason = f"inputs {first} to {end} ended the process with {done.returncode}"
    return {"valid": 0, "refused": 0, "slowest": 0.0, "wrong": [reason]}


def main() -> None:
    name, first, end = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    valid, refused, slowest, wrong = 0, 0, 0.0, []
    with tempfile.TemporaryDirectory() as temporary:
        for number in range(first, end):
            began = time.perf_counter()
            try:
                READERS[name](Path(temporary), random.Random(f"{name} {number}"))
                valid += 1
            except DanteError as error:
                refused += 1
                if "\n" in str(error):
                    wrong.append(f"input {number}: more than one line: {error}")
            except Exception as error:
                wrong.append(f"input {number}: {type(error).__name__}: {error}")
            slowest = max(slowest, time.perf_counter() - began)
    print(json.dumps({"valid": valid, "refused": refused, "slowest": slowest, "wrong": wrong}))


if __name__ == "__main__":
    main()
