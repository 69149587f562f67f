"""DANTE-W for Blender: diffuse albedo textures from posed photos of a UV-mapped mesh.

This file only registers; see docs/architecture.md for the parts.
"""

from __future__ import annotations

import bpy

from .blender import known_colours, properties
from .bridge import headless, job
from .operators import import_scene, known_colour, recover, relight, setup
from .ui import overlay, panels, preferences

_CLASSES = (
    *preferences.CLASSES,
    *setup.CLASSES,
    *import_scene.CLASSES,
    *recover.CLASSES,
    *known_colour.CLASSES,
    *relight.CLASSES,
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
    overlay.register()
    relight.register()
    _commands.append(bpy.utils.register_cli_command("dante_w", headless.main))


def unregister() -> None:
    """Undo `register`; a running backend is stopped."""
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    relight.unregister()
    overlay.unregister()
    job.unregister()
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    known_colours.unregister()
    properties.unregister()
