"""Spots of the mesh whose albedo is known; they fix the recovered albedo's scale and white balance.

Kept on the object, as each is a place in its UV map.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, FloatVectorProperty, StringProperty
from mathutils import Vector

from . import mesh, surface


class DANTEW_PG_known_colour(bpy.types.PropertyGroup):
    """A spot whose albedo is known."""

    u: FloatProperty(name="U", description="Texture coordinate of the spot")
    v: FloatProperty(name="V", description="Texture coordinate of the spot, upwards")
    uv_map: StringProperty(name="UV Map", description="The UV map that the coordinates belong to")
    location: FloatVectorProperty(name="Location", description="The spot on the mesh", subtype="XYZ")
    grey: BoolProperty(
        name="Grey",
        description="The spot is a neutral grey of unknown brightness. It fixes the white balance alone",
        default=True,
    )
    colour: FloatVectorProperty(
        name="Colour",
        description="The spot's albedo in sRGB, for example a colour chart's value",
        subtype="COLOR_GAMMA",
        default=(0.5, 0.5, 0.5),
        min=0.0,
        max=1.0,
    )


def spots_of(obj: bpy.types.Object) -> bpy.types.bpy_prop_collection:
    """The known colours of a mesh object."""
    return obj.dante_w_known_colours


def add(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, point: Vector, face: int
) -> DANTEW_PG_known_colour:
    """Add a grey spot at a point (in the object's space) on a face of the evaluated mesh.

    Raises:
        BadInput: the mesh has no UV map.
    """
    u, v, uv_map = surface.uv_at(obj, depsgraph, point, face)
    spot = spots_of(obj).add()
    spot.u, spot.v, spot.uv_map, spot.location = u, v, uv_map, point
    return spot


def problem(obj: bpy.types.Object, unwrap: bool) -> str | None:
    """Why the known colours of `obj` cannot be used, in a sentence; None where they can, or there are none.

    `unwrap`: whether the recovery is to make new UVs.
    """
    if not spots_of(obj):
        return None
    if unwrap:
        return f"The known colours of {obj.name} do not fit new UVs; make no new UVs, or remove the colours."
    layer = mesh.render_uv_map(obj.data)  # None where a modifier makes the UV map: then the spots are trusted
    other_maps = {spot.uv_map for spot in spots_of(obj)} - {layer.name} if layer is not None else set()
    if other_maps:
        return (
            f"Known colours of {obj.name} were picked on the UV map {min(other_maps)}; "
            "remove and pick them again."
        )
    return None


def as_words(obj: bpy.types.Object) -> tuple[tuple[str, str, str], ...]:
    """U, V and COLOUR of each spot, as the backend's `--known` takes them."""
    return tuple(
        (f"{spot.u:.6f}", f"{spot.v:.6f}", "grey" if spot.grey else _hex(spot.colour))
        for spot in spots_of(obj)
    )


def _hex(colour: Sequence[float]) -> str:
    return "#" + "".join(f"{round(255.0 * channel):02X}" for channel in colour)


def register() -> None:
    """Make known colours part of every object."""
    bpy.utils.register_class(DANTEW_PG_known_colour)
    bpy.types.Object.dante_w_known_colours = CollectionProperty(type=DANTEW_PG_known_colour)


def unregister() -> None:
    """Undo `register`."""
    del bpy.types.Object.dante_w_known_colours
    bpy.utils.unregister_class(DANTEW_PG_known_colour)
