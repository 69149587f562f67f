"""From the ray cache to an albedo texture by traced light, with no network and no prior."""

from __future__ import annotations

from typing import Any

import numpy as np

from dante_w.progress import Progress
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.raycast import Frame3D, Raycaster
from dante_w.scene.mesh import Mesh
from dante_w.scene.scene_folder import Frame
from dante_w.traced.albedo import albedo_texture
from dante_w.traced.groups import first_groups
from dante_w.traced.lights import solve_lights
from dante_w.traced.shading_points import gather
from dante_w.traced.transfer import trace_transfer

#: Directions that light comes from: fewer lose the shadows' edges, more cost time (cubed) and tell no more.
DIRECTIONS = 256


def recover_albedo(
    cache: RayCache,
    footprints: np.ndarray,
    mesh: Mesh,
    frames: list[Frame],
    size: int,
    seed: int,
    progress: Progress,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The albedo (size, size, 3), float32 and linear, and facts for the report.

    Args:
        footprints: (N,) of the cache's samples, as fractions of the texture's side.
    """
    frame3d = Frame3D.of(mesh.vertices)
    cameras = frame3d.normalise(np.stack([frame.camera_to_world[:3, 3] for frame in frames]))
    progress.update("transfer", 0.0, 1.0)
    points, seen = gather(cache, cameras)
    transfer = trace_transfer(
        points,
        Raycaster(mesh, frame3d),
        cache.surface.uvs.numpy(),
        DIRECTIONS,
        lambda done: progress.update("transfer", done, 1.0),
    )
    progress.update("lights", 0.0, 1.0)
    groups = first_groups(seen, len(points), len(frames))
    lights = solve_lights(
        points,
        transfer,
        seen,
        cameras,
        groups,
        seed,
        lambda step, steps: progress.update("lights", step, steps),
    )
    texture = albedo_texture(
        cache,
        footprints,
        points,
        transfer,
        lights,
        cameras,
        size,
        lambda done: progress.update("albedo", done, 1.0),
    )
    return texture, {"lights": [int(light) for light in lights.light], "shading_points": len(points)}
