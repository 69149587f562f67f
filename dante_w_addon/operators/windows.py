"""Editors that show the user an image or a text."""

from __future__ import annotations

import bpy


def open_editor(context: bpy.types.Context, kind: str, data: bpy.types.ID) -> None:
    """Show `data` in an editor of `kind` ('IMAGE_EDITOR', 'TEXT_EDITOR') on screen, or in a new window."""
    manager = context.window_manager
    areas = [area for window in manager.windows for area in window.screen.areas if area.type == kind]
    if not areas and len(manager.windows):
        old_windows = set(manager.windows)
        bpy.ops.wm.window_new()
        new_window = next(window for window in manager.windows if window not in old_windows)
        areas = [max(new_window.screen.areas, key=lambda area: area.width * area.height)]
        areas[0].type = kind
    for area in areas[:1]:
        space = area.spaces.active
        if kind == "IMAGE_EDITOR":
            space.image = data
            region = next(region for region in area.regions if region.type == "WINDOW")
            with context.temp_override(window=_window_of(manager, area), area=area, region=region):
                if bpy.ops.image.view_all.poll():
                    bpy.ops.image.view_all(fit_view=True)
        else:
            space.text = data
        area.tag_redraw()


def _window_of(manager: bpy.types.WindowManager, area: bpy.types.Area) -> bpy.types.Window:
    return next(window for window in manager.windows if area in list(window.screen.areas))
