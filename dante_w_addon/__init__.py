"""DANTE-W for Blender: diffuse albedo textures from posed photos of a UV-mapped mesh.

This file only registers; see docs/architecture.md for the parts.
"""

from __future__ import annotations

import bpy

from . import (
    headless,
    job,
    known_colour_markers,
    known_colour_operators,
    known_colours,
    panels,
    preferences,
    properties,
    recover,
    relight_operators,
)

_CLASSES = (
    *preferences.CLASSES,
    *recover.CLASSES,
    *known_colour_operators.CLASSES,
    *relight_operators.CLASSES,
    *panels.CLASSES,
)
_commands = []


def register() -> None:
    """Add the panel, the operators and the command `blender -c dante_w`."""
    properties.register()
    known_colours.register()
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    job.register()
    known_colour_markers.register()
    relight_operators.register()
    _commands.append(bpy.utils.register_cli_command("dante_w", headless.main))


def unregister() -> None:
    """Undo `register`; a running backend is stopped."""
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    relight_operators.unregister()
    known_colour_markers.unregister()
    job.unregister()
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    known_colours.unregister()
    properties.unregister()
