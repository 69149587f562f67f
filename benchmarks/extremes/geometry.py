"""Scale, place and turn of the scene, odd triangles, odd cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from dante_w.contract.scene_folder import Camera
from dante_w.scene.mesh import Mesh

from extremes.judge import MODELS, alike, as_good, tried, unspoilt
from extremes.row import Row
from extremes.world import FOCAL, SIDE, World, around, hills, looking, make, photograph

FAMILY = "geometry"
QUARTER = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
TURN = np.array([(2.0, -1.0, 2.0), (2.0, 2.0, -1.0), (-1.0, 2.0, 2.0)]) / 3.0


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    for model, options in MODELS.items():
        own = unspoilt(model)
        # float64 places are recentred before anything is float32
        least = {"traced": 45.0, "field": 45.0}[model]
        for scale in (1e-6, 1e-3, 1e3, 1e6):
            progress(f"scale {scale:g}, {model}")
            yield alike(
                FAMILY, f"scene times {scale:g}, {model}", tried(scaled(base, scale), *options), own, least
            )
        progress(f"offset, {model}")
        yield alike(
            FAMILY, f"scene moved by 1e7 sides, {model}", tried(moved(base, 1e7), *options), own, least
        )
        for name, rotation in (("a quarter turn about the vertical", QUARTER), ("any turn", TURN)):
            progress(f"{name}, {model}")
            yield as_good(
                FAMILY, f"scene turned, {name}, {model}", tried(turned(base, rotation), *options), own, 2.0
            )
        progress(f"photos in another order, {model}")
        order = [5, 2, 7, 0, 3, 6, 1, 4]
        shuffled = replace(base, poses=[base.poses[i] for i in order], photos=[base.photos[i] for i in order])
        yield as_good(FAMILY, f"photos in another order, {model}", tried(shuffled, *options), own, 2.0)
        progress(f"triangles in another order, {model}")
        faces = np.random.default_rng(1).permutation(len(base.mesh.faces))
        assert base.mesh.uvs is not None
        mesh = Mesh(base.mesh.vertices, base.mesh.faces[faces], base.mesh.uvs[faces])
        yield alike(
            FAMILY,
            f"triangles in another order, {model}",
            tried(replace(base, mesh=mesh), *options),
            own,
            least,
        )
        progress(f"tele, {model}")
        yield as_good(
            FAMILY, f"cameras 10,000 sides away, against 10, {model}",
            tried(tele(1e4), *options), tried(tele(10.0), *options), 3.0,
        )  # fmt: skip
        for name, world in odd_triangles(base).items():
            progress(f"{name}, {model}")
            yield alike(FAMILY, f"{name}, {model}", tried(world, *options), own, 40.0)
        for name, world in odd_cameras(base).items():
            progress(f"{name}, {model}")
            yield as_good(FAMILY, f"{name}, {model}", tried(world, *options), own, 1.5)


def scaled(world: World, scale: float) -> World:
    """Mesh and cameras times `scale`."""
    mesh = replace(world.mesh, vertices=world.mesh.vertices * scale)
    return replace(world, mesh=mesh, poses=[_placed(pose, pose[:3, 3] * scale) for pose in world.poses])


def moved(world: World, offset: float) -> World:
    """Mesh and cameras moved by `offset` along each axis."""
    mesh = replace(world.mesh, vertices=world.mesh.vertices + offset)
    return replace(world, mesh=mesh, poses=[_placed(pose, pose[:3, 3] + offset) for pose in world.poses])


def turned(world: World, rotation: np.ndarray) -> World:
    """Mesh and cameras turned by `rotation` (3, 3) about the origin."""
    mesh = replace(world.mesh, vertices=world.mesh.vertices @ rotation.T)
    whole = np.eye(4)
    whole[:3, :3] = rotation
    return replace(world, mesh=mesh, poses=[whole @ pose for pose in world.poses])


def tele(away: float) -> World:
    """Photos from `away` sides off through a lens that shows as much as ever."""
    poses = []
    for index in range(len(make().poses)):
        eye = around(index)[:3, 3] - (0.5, 0.5, 0.0)
        poses.append(looking((0.5, 0.5, 0.0) + eye * away / np.linalg.norm(eye)))
    camera = Camera("PINHOLE", SIDE, SIDE, (FOCAL * SIDE * away, FOCAL * SIDE * away, SIDE / 2, SIDE / 2))
    mesh = hills()
    return World(mesh, camera, poses, [photograph(mesh, camera, own, k)[0] for k, own in enumerate(poses)])


def odd_triangles(world: World) -> dict[str, World]:
    """The same surface with triangles that are not as they should be."""
    mesh = world.mesh
    assert mesh.uvs is not None
    every = np.arange(len(mesh.faces)) % 3 == 0
    flipped, flipped_uvs = mesh.faces.copy(), mesh.uvs.copy()
    flipped[every], flipped_uvs[every] = flipped[every][:, ::-1], flipped_uvs[every][:, ::-1]
    points = np.repeat(mesh.faces[::5, :1], 3, axis=1)  # no length, no area
    lines = mesh.faces[::5][:, [0, 1, 1]]
    thin = np.concatenate([mesh.faces, points, lines])
    thin_uvs = np.concatenate([mesh.uvs, mesh.uvs[::5], mesh.uvs[::5]])
    thin_uvs[len(mesh.faces) :] = thin_uvs[len(mesh.faces) :, :1]
    stray = np.concatenate([mesh.vertices, [[1e6, 1e6, 1e6]]])
    return {
        "every third triangle flipped": replace(world, mesh=Mesh(mesh.vertices, flipped, flipped_uvs)),
        "every triangle flipped": replace(world, mesh=Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.uvs[:, ::-1])),
        "triangles without area": replace(world, mesh=Mesh(mesh.vertices, thin, thin_uvs)),
        "a vertex of no triangle, a million sides off": replace(world, mesh=Mesh(stray, mesh.faces, mesh.uvs)),
    }  # fmt: skip


def odd_cameras(world: World) -> dict[str, World]:
    """One more photo, from a camera where none should be."""
    mesh = world.mesh
    middle = mesh.vertices[mesh.faces[200]].mean(axis=0)
    away = looking(np.array([0.5, 0.5, 1.2]), np.array([0.5, 0.5, 9.0]))
    below = looking(np.array([0.5, 0.5, -1.2]))
    on = looking(middle, np.array([0.9, 0.1, 0.2]))
    at = looking(mesh.vertices[mesh.faces[200, 0]], np.array([0.1, 0.9, 0.1]))
    return {
        "a ninth camera that looks away": _with(world, away),
        "a ninth camera below the surface": _with(world, below),
        "a ninth camera on the surface": _with(world, on),
        "a ninth camera in a vertex": _with(world, at),
    }


def _with(world: World, pose: np.ndarray) -> World:
    photo, _ = photograph(world.mesh, world.camera, pose, len(world.poses))
    return replace(world, poses=[*world.poses, pose], photos=[*world.photos, photo])


def _placed(pose: np.ndarray, where: np.ndarray) -> np.ndarray:
    matrix = pose.copy()
    matrix[:3, 3] = where
    return matrix
