"""Scenes and results that tests share."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # before triton is first imported: its kernels then run on the CPU

import command_runs
from command_runs import Result
from dante_w.contract.scene_folder import Frame
from dante_w.rays.cast_photos import CAST, CastSettings, Visitor, cast_photos
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.scene3d import Scene3D
from dante_w.scene.mesh import Mesh
from square_scene import make_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene folder of eight photos of the square, each with its own exposure and light."""
    return make_scene(tmp_path / "scene")


@pytest.fixture(scope="session")
def square(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same scene for all tests that only read it."""
    return make_scene(tmp_path_factory.mktemp("square") / "scene")


@pytest.fixture(scope="session")
def recovered(square: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Result]:
    """Recoveries of that scene by their options: each is made once, for all tests that only read it."""

    @functools.cache
    def once(*options: str) -> Result:
        return command_runs.recover(square, tmp_path_factory.mktemp("recovered") / "out", *options)

    return once


def cast(
    mesh: Mesh,
    frames: list[Frame],
    folder: Path,
    visit: Visitor = lambda *_: None,
    settings: CastSettings = CAST,
) -> RayCache:
    """The ray cache of photos of a mesh, in `folder` where it does not fit into memory."""
    return cast_photos(Scene3D.build(mesh), frames, visit, lambda _: None, folder, settings)
