"""Operators: import a scene folder, and fit the render to a photo."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..blender import photos, scene_import
from ..contract.errors import BadInput


class DANTEW_OT_import_scene(bpy.types.Operator):
    """Import a scene folder (transforms.json): cameras with their photos, and the mesh"""

    bl_idname = "dantew.import_scene"
    bl_label = "Import Scene Folder"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            result = scene_import.import_folder(context, Path(bpy.path.abspath(self.filepath)))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for warning in result.warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{len(result.cameras)} cameras imported")
        return {"FINISHED"}


class DANTEW_OT_match_render(bpy.types.Operator):
    """Set the render size to that of the camera's photo, so that photo and mesh line up in the viewport"""

    bl_idname = "dantew.match_render"
    bl_label = "Match Render to Photo"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if active_photo(context.scene) is None:
            cls.poll_message_set("The scene's camera has no photo behind it")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            width, height = photos.size_of(active_photo(context.scene).image)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.scene.render.resolution_x, context.scene.render.resolution_y = width, height
        return {"FINISHED"}


def active_photo(scene: bpy.types.Scene) -> photos.Photo | None:
    """The photo behind the scene's camera."""
    return next((photo for photo in photos.photos_in(scene) if photo.camera == scene.camera), None)


CLASSES = (DANTEW_OT_import_scene, DANTEW_OT_match_render)
