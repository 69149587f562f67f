"""One photo, one pixel, one triangle; ten million triangles."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from dante_w.scene.mesh import Mesh

from extremes.judge import MODELS, as_good, finite, tried, unspoilt
from extremes.row import Row
from extremes.world import SIDE, hills, make, recover_apart, write

FAMILY = "size"
QUADS = 2237  # 2 x 2237^2 triangles
MOST_MEMORY = 16e9


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    for model, options in MODELS.items():
        for photos in (1, 2):
            progress(f"{photos} photo, {model}")
            few = replace(base, poses=base.poses[:photos], photos=base.photos[:photos])
            yield as_good(
                FAMILY,
                f"{photos} photo{'s'[: photos - 1]}, {model}",
                tried(few, *options),
                unspoilt(model),
                4.0,
            )
        for side, name in ((1, "photos of one pixel"), (4, "photos of 4 x 4 pixels")):
            progress(f"{name}, {model}")
            yield finite(FAMILY, f"{name}, {model}", tried(make(side=side), *options), varied=False)
        progress(f"one triangle, {model}")
        corners = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.1), (0.2, 1.0, -0.1)])
        one = Mesh(corners, np.array([[0, 1, 2]], np.int32), corners[None, :, :2].copy())
        yield finite(FAMILY, f"one triangle, {model}", tried(make(one), *options))
        progress(f"one texel, {model}")
        yield finite(FAMILY, f"a texture of one texel, {model}", tried(base, *options, size=1), varied=False)
    for model, options in MODELS.items():
        progress(f"ten million triangles, {model}: minutes")
        yield large(model, options)


def large(model: str, options: tuple[str, ...]) -> Row:
    """The same hills in ten million triangles, in a process of its own, with the preset's own settings."""
    base = make()
    name, bound = f"10 million triangles, {model}, draft", f"a result, in at most {MOST_MEMORY / 1e9:g} GB"
    with tempfile.TemporaryDirectory(prefix="dante-w-stability-") as folder:
        scene = write(base, Path(folder) / "scene")
        write_ply(scene / "mesh.ply", hills(QUADS))
        outcome = recover_apart(scene, *options, "--mesh", str(scene / "mesh.ply"), size=1024)
    if outcome.code:
        return Row(name, FAMILY, f"exit {outcome.code}", bound, False, outcome.message)
    memory, seconds = outcome.report["peak_memory_bytes"], sum(outcome.report["seconds"].values())
    sound = outcome.albedo is not None and bool(np.isfinite(outcome.albedo).all())
    measured = f"{memory / 1e9:.1f} GB, {seconds:.0f} s"
    return Row(
        name, FAMILY, measured, bound, sound and memory <= MOST_MEMORY, f"8 photos of {SIDE} x {SIDE}; PLY"
    )


def write_ply(path: Path, mesh: Mesh) -> None:
    """Binary PLY with a UV a vertex: for meshes whose corners share them."""
    assert mesh.uvs is not None
    uv = np.empty((len(mesh.vertices), 2))
    uv[mesh.faces.reshape(-1)] = mesh.uvs.reshape(-1, 2)
    vertices = np.empty(len(uv), [(name, "<f8") for name in "xyzst"])
    for name, column in zip("xyzst", np.column_stack([mesh.vertices, uv]).T, strict=True):
        vertices[name] = column
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property double {name}" for name in "xyzst"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(lines).encode())
        vertices.tofile(file)
        faces.tofile(file)
