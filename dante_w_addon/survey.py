"""What the Source panel says about the scene; cheap enough to be asked at every redraw."""

from __future__ import annotations

import time
from dataclasses import dataclass

import bpy

from . import mesh, photos

MAX_AGE = 2.0  # seconds: whether thousands of files exist is not asked at every redraw


@dataclass(frozen=True)
class Survey:
    """What was found, and what stands in the way of recovery, a sentence each."""

    cameras: int
    photos: int
    problems: tuple[str, ...]


_last: tuple[float, tuple, Survey] | None = None


def active_mesh(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object, where it is a mesh."""
    obj = context.view_layer.objects.active if context.view_layer else None
    return obj if obj is not None and obj.type == "MESH" else None


def take(scene: bpy.types.Scene, obj: bpy.types.Object | None, unwrap: bool) -> Survey:
    """Survey `scene`; the answer may be MAX_AGE old while the counts stay."""
    global _last
    found = photos.found(scene)
    key = (scene.name_full, obj.name_full if obj else "", unwrap, len(found), len(scene.objects))
    if _last is not None and _last[1] == key and time.monotonic() - _last[0] < MAX_AGE:
        return _last[2]
    cameras = sum(other.type == "CAMERA" for other in scene.objects)
    result = Survey(cameras, len(found), tuple(_problems(found, obj, unwrap)))
    _last = (time.monotonic(), key, result)
    return result


def _problems(found: list[photos.Photo], obj: bpy.types.Object | None, unwrap: bool):
    if obj is not None and not unwrap and mesh.render_uv_map(obj.data) is None and not obj.modifiers:
        yield f"{obj.name} has no UV map; unwrap it, or turn on Make New UVs."
    if not found:
        yield "No camera has a background image; add photos, or import a scene folder."
    yield from filter(None, map(photos.problem, found))
