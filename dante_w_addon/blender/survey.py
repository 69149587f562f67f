"""What the Source panel says about the scene; cheap enough to be asked at every redraw."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

import bpy

from . import known_colours, mesh, photos, properties

#: Seconds for which a survey counts: whether thousands of files exist is not asked at every redraw.
MAX_AGE = 2.0
#: By how much, relatively, the render's aspect ratio may differ from the photo's.
ASPECT_TOLERANCE = 0.01


@dataclass(frozen=True)
class Survey:
    """The state of a scene.

    Attributes:
        cameras, photos: how many cameras there are, and how many have a photo.
        problems: what stands in the way of recovery, a sentence each.
        overlay_off: whether the photo behind the scene's camera has another aspect ratio than the render, so that the
            viewport does not show it in its true place.
    """

    cameras: int
    photos: int
    problems: tuple[str, ...]
    overlay_off: bool = False


_cache: tuple[float, tuple, Survey] | None = None


def active_mesh(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, where it is a mesh."""
    obj = context.view_layer.objects.active if context.view_layer else None
    return obj if obj is not None and obj.type == "MESH" else None


def examine(scene: bpy.types.Scene, obj: bpy.types.Object | None) -> Survey:
    """Survey `scene`; the answer may be MAX_AGE old while the counts stay."""
    global _cache
    settings, render = properties.settings_of(scene), scene.render
    photo_list = photos.photos_in(scene)
    key = (
        *(scene.name_full, obj.name_full if obj else "", len(photo_list), len(scene.objects)),
        len(known_colours.spots_of(obj)) if obj else 0,
        *(settings.unwrap, settings.prior_folder, render.resolution_x, render.resolution_y),
        scene.camera.name_full if scene.camera else "",
    )
    if _cache is not None and _cache[1] == key and time.monotonic() - _cache[0] < MAX_AGE:
        return _cache[2]
    cameras = sum(other.type == "CAMERA" for other in scene.objects)
    problems = tuple(_problems(photo_list, obj, settings))
    result = Survey(cameras, len(photo_list), problems, _overlay_off(scene, photo_list))
    _cache = (time.monotonic(), key, result)
    return result


def _problems(
    photo_list: list[photos.Photo], obj: bpy.types.Object | None, settings: properties.DANTEW_PG_settings
) -> Iterator[str]:
    if obj is not None and not settings.unwrap and mesh.render_uv_map(obj.data) is None and not obj.modifiers:
        yield f"{obj.name} has no UV map; unwrap it, or turn on Options > Make New UVs."
    colour_problem = known_colours.problem(obj, settings.unwrap) if obj is not None else None
    if colour_problem:
        yield colour_problem
    if not photo_list:
        yield "No camera has a background image; add photos, or import a scene folder."
    if settings.prior_folder and not os.path.isdir(bpy.path.abspath(settings.prior_folder)):
        yield "The folder of priors does not exist; choose another, or clear it."
    yield from filter(None, map(photos.problem, photo_list))


def _overlay_off(scene: bpy.types.Scene, photo_list: list[photos.Photo]) -> bool:
    photo = next((photo for photo in photo_list if photo.camera == scene.camera), None)
    path = photos.path_of(photo.image) if photo else None
    size = photos.header_size(path) if path else None
    if size is None:
        return False
    first, second = size[0] * scene.render.resolution_y, size[1] * scene.render.resolution_x
    return abs(first - second) > ASPECT_TOLERANCE * max(first, second)
