"""Numbered rings in the 3D view where the active mesh's colour is known."""

from __future__ import annotations

import blf
import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.presets import draw_circle_2d
from mathutils import Vector

from ..blender import known_colours, survey

#: Radius of a ring and size of its number, in pixels times the interface's scale.
RADIUS, TEXT = 7.0, 12.0

_handles = []


def draw() -> None:
    """Draw the rings over the 3D view, also those of spots behind the mesh."""
    context = bpy.context
    obj = survey.active_mesh(context)
    if obj is None or not context.space_data.overlay.show_overlays:
        return
    scale = context.preferences.system.ui_scale
    for number, spot in enumerate(known_colours.spots_of(obj), 1):
        location = obj.matrix_world @ Vector(spot.location)
        centre = location_3d_to_region_2d(context.region, context.region_data, location)
        if centre is None:  # behind the viewer
            continue
        for ring, colour in ((RADIUS, (0.0, 0.0, 0.0, 1.0)), (RADIUS - 1.5, (1.0, 1.0, 1.0, 1.0))):
            draw_circle_2d(centre, colour, ring * scale, segments=32)
        blf.size(0, TEXT * scale)
        blf.color(0, 1.0, 1.0, 1.0, 1.0)
        blf.position(0, centre.x + 1.5 * RADIUS * scale, centre.y - 0.35 * TEXT * scale, 0.0)
        blf.draw(0, str(number))


def register() -> None:
    """Draw in every 3D view from now on."""
    _handles.append(bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Undo `register`."""
    while _handles:
        bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")
