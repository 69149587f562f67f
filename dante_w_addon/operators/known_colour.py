"""Operators: pick a spot of the mesh whose albedo is known, and remove one."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, FloatVectorProperty, IntProperty
from bpy_extras import view3d_utils
from mathutils import Vector

from ..blender import known_colours, properties, surface, survey
from ..contract.errors import BadInput

#: Events that move the view while the user looks for a spot.
NAVIGATION = {
    *("MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE"),
    *("TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "NDOF_MOTION", "TIMER"),
}


class DANTEW_OT_pick_known_colour(bpy.types.Operator):
    """Click a spot of the mesh that is grey, or whose colour you know. It fixes white balance and brightness of the albedo"""

    bl_idname = "dantew.pick_known_colour"
    bl_label = "Pick Known Colour"
    bl_options = {"REGISTER", "UNDO"}

    location: FloatVectorProperty(
        name="Location",
        description="A point on the mesh or near it, in the object's space",
        subtype="XYZ",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    face: IntProperty(
        name="Face",
        description="The face of the evaluated mesh that the point is on; -1: the nearest",
        default=-1,
        min=-1,
        options={"HIDDEN", "SKIP_SAVE"},
    )
    grey: BoolProperty(
        name="Grey",
        description="The spot is a neutral grey of unknown brightness. It fixes the white balance alone",
        default=True,
        options={"SKIP_SAVE"},
    )
    colour: FloatVectorProperty(
        name="Colour",
        description="The spot's albedo in sRGB, for example a colour chart's value",
        subtype="COLOR_GAMMA",
        default=(0.5, 0.5, 0.5),
        min=0.0,
        max=1.0,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        if obj is None:
            cls.poll_message_set("Make the mesh the active object")
        elif obj.mode == "EDIT":
            cls.poll_message_set("Leave edit mode first")
        elif not obj.visible_get():
            cls.poll_message_set("Unhide the mesh first")
        elif properties.settings_of(context.scene).unwrap:
            cls.poll_message_set("Known colours need the present UVs; turn off Options > Make New UVs")
        else:
            return True
        return False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(
            "Click a spot of the mesh that is grey or whose colour you know. Esc or right click cancels"
        )
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type in NAVIGATION:
            return {"PASS_THROUGH"}
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            hit = self._hit(context, Vector((event.mouse_x, event.mouse_y)))
            if hit is None:
                self.report({"WARNING"}, "The click missed the mesh; click on it, or press Esc")
            else:
                self.cancel(context)
                self.location, self.face = hit
                return self.execute(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj, depsgraph = survey.active_mesh(context), context.evaluated_depsgraph_get()
        point, face = Vector(self.location), self.face
        try:
            if face < 0:
                point, face = surface.nearest_point(obj, depsgraph, point)
            spot = known_colours.add(obj, depsgraph, point, face)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        spot.grey, spot.colour = self.grey, self.colour
        return {"FINISHED"}

    def _hit(self, context: bpy.types.Context, mouse: Vector) -> tuple[Vector, int] | None:
        """Where the ray under `mouse` (in the window's pixels) meets the active mesh: location and face."""
        region = _view_at(context.screen, mouse)
        if region is None:
            return None
        position = mouse - Vector((region.x, region.y))
        origin = view3d_utils.region_2d_to_origin_3d(region, region.data, position)
        direction = view3d_utils.region_2d_to_vector_3d(region, region.data, position)
        obj, depsgraph = survey.active_mesh(context), context.evaluated_depsgraph_get()
        return surface.cast_ray(obj, depsgraph, origin, direction)


class DANTEW_OT_remove_known_colour(bpy.types.Operator):
    """Forget this known colour"""

    bl_idname = "dantew.remove_known_colour"
    bl_label = "Remove Known Colour"
    bl_options = {"REGISTER", "UNDO"}

    index: IntProperty(min=0)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = survey.active_mesh(context)
        return obj is not None and len(known_colours.spots_of(obj)) > 0

    def execute(self, context: bpy.types.Context) -> set[str]:
        spots = known_colours.spots_of(survey.active_mesh(context))
        if self.index >= len(spots):
            self.report({"ERROR"}, f"There are only {len(spots)} known colours.")
            return {"CANCELLED"}
        spots.remove(self.index)
        return {"FINISHED"}


def _view_at(screen: bpy.types.Screen, mouse: Vector) -> bpy.types.Region | None:
    """The 3D view under `mouse`, in pixels of the window: one of four in a quad view, None for another editor."""
    for area in screen.areas:
        regions = [region for region in area.regions if _contains(region, mouse)]
        if area.type == "VIEW_3D" and regions and all(region.type == "WINDOW" for region in regions):
            return regions[0]  # no sidebar or header lies over it
    return None


def _contains(region: bpy.types.Region, mouse: Vector) -> bool:
    x, y = mouse - Vector((region.x, region.y))
    return 0.0 <= x < region.width and 0.0 <= y < region.height


CLASSES = (DANTEW_OT_pick_known_colour, DANTEW_OT_remove_known_colour)
