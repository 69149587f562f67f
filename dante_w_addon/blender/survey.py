"""What the Source panel says about the scene; cheap enough to be asked at every redraw."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

import bpy

from . import known_colours, mesh, photos, properties

MAX_AGE = 2.0  # seconds: whether thousands of files exist is not asked at every redraw


@dataclass(frozen=True)
class Survey:
    """What was found, and what stands in the way of recovery, a sentence each.

    `overlay_off`: the photo behind the scene's camera has another shape than the render, so the viewport
    does not show it where recovery takes it to be.
    """

    cameras: int
    photos: int
    problems: tuple[str, ...]
    overlay_off: bool = False


_last: tuple[float, tuple, Survey] | None = None


def active_mesh(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, where it is a mesh."""
    obj = context.view_layer.objects.active if context.view_layer else None
    return obj if obj is not None and obj.type == "MESH" else None


def examine(scene: bpy.types.Scene, obj: bpy.types.Object | None) -> Survey:
    """Survey `scene`; the answer may be MAX_AGE old while the counts stay."""
    global _last
    settings, render = properties.settings_of(scene), scene.render
    found = photos.found(scene)
    key = (
        *(scene.name_full, obj.name_full if obj else "", len(found), len(scene.objects)),
        len(known_colours.spots_of(obj)) if obj else 0,
        *(settings.unwrap, settings.prior_folder, scene.camera, render.resolution_x, render.resolution_y),
    )
    if _last is not None and _last[1] == key and time.monotonic() - _last[0] < MAX_AGE:
        return _last[2]
    cameras = sum(other.type == "CAMERA" for other in scene.objects)
    problems = tuple(_problems(found, obj, settings))
    result = Survey(cameras, len(found), problems, _overlay_off(scene, found))
    _last = (time.monotonic(), key, result)
    return result


def _problems(
    found: list[photos.Photo], obj: bpy.types.Object | None, settings: properties.DANTEW_PG_settings
) -> Iterator[str]:
    if obj is not None and not settings.unwrap and mesh.render_uv_map(obj.data) is None and not obj.modifiers:
        yield f"{obj.name} has no UV map; unwrap it, or turn on Options > Make New UVs."
    known = known_colours.problem(obj, settings.unwrap) if obj is not None else None
    if known:
        yield known
    if not found:
        yield "No camera has a background image; add photos, or import a scene folder."
    if settings.prior_folder and not os.path.isdir(bpy.path.abspath(settings.prior_folder)):
        yield "The folder of priors does not exist; choose another, or clear it."
    yield from filter(None, map(photos.problem, found))


def _overlay_off(scene: bpy.types.Scene, found: list[photos.Photo]) -> bool:
    photo = next((photo for photo in found if photo.camera == scene.camera), None)
    path = photos.path_of(photo.image) if photo else None
    size = photos.header_size(path) if path else None
    if size is None:
        return False
    wide, high = size[0] * scene.render.resolution_y, size[1] * scene.render.resolution_x
    return abs(wide - high) > 0.01 * max(wide, high)
