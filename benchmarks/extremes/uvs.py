"""Texture coordinates without area, outside the unit square, in UDIM tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from dante_w.scene.mesh import Mesh

from extremes.judge import MODELS, as_good, finite, refused, tried, unspoilt
from extremes.row import Row
from extremes.world import World, make

FAMILY = "texture coordinates"


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    uvs = base.mesh.uvs
    assert uvs is not None
    some = np.arange(len(uvs)) % 10 == 0
    for model, options in MODELS.items():
        for name, values in (
            ("a tenth of the triangles has UVs in one point", uvs[:, :1].repeat(3, axis=1)),
            ("a tenth of the triangles has UVs at 0 0", np.zeros_like(uvs)),
            ("a tenth of the triangles has UVs on a line", uvs[:, [0, 1, 1]]),
        ):
            progress(f"{name}, {model}")
            spoilt = np.where(some[:, None, None], values, uvs)
            yield as_good(
                FAMILY, f"{name}, {model}", tried(_with(base, spoilt), *options), unspoilt(model), 2.0
            )
        progress(f"mirrored, {model}")
        mirrored = tried(_with(base, uvs * (-1.0, 1.0) + (1.0, 0.0)), *options)
        assert mirrored.albedo is None or mirrored.seen is not None
        back = mirrored if mirrored.albedo is None else replace(mirrored, albedo=mirrored.albedo[:, ::-1])
        yield as_good(FAMILY, f"mirrored UVs, {model}", back, unspoilt(model), 2.0)
    for name, values, word in (
        ("all UVs in one point", np.full_like(uvs, 0.5), "without any area"),
        ("UVs three times as large, to be repeated", 3.0 * uvs, "outside 0 to 1"),
        ("UVs one tile to the right", uvs + np.array([1.0, 0.0]), "outside 0 to 1"),
        ("four UDIM tiles", 2.0 * uvs, "UDIM"),
        ("UVs of a billion", uvs * 1e9, "outside 0 to 1"),
        ("UVs that lie on each other", np.where(some[:, None, None], uvs[::10].repeat(10, axis=0)[: len(uvs)], 0.5 * uvs), "overlap"),
    ):  # fmt: skip
        progress(name)
        yield refused(FAMILY, name, tried(_with(base, values)), word)
    progress("unwrapped")
    yield finite(FAMILY, "four UDIM tiles and --unwrap", tried(_with(base, 2.0 * uvs), "--unwrap"))


def _with(world: World, uvs: np.ndarray) -> World:
    return replace(world, mesh=Mesh(world.mesh.vertices, world.mesh.faces, np.ascontiguousarray(uvs)))
