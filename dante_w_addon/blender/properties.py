"""What the user can set in the panel; saved with the scene.

A .blend file stores the number of a menu's entry: entries keep their order, new ones come last.
"""

from __future__ import annotations

from collections.abc import Mapping

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..contract.vocabulary import (
    COMPONENTS,
    DEVICES,
    FORMATS,
    LARGEST_TEXTURE,
    MODEL_PRESETS,
    MODELS,
    PRESETS,
    Label,
    component,
)
from . import hdris

AUTOMATIC = "AUTO"
_SIZES = [
    (AUTOMATIC, "Automatic", "As fine as the photos, within the preset's limits"),
    *((str(1 << n), str(1 << n), f"{1 << n} texels a side") for n in range(10, LARGEST_TEXTURE.bit_length())),
]
_CHOICES = (
    (AUTOMATIC, "Automatic", "Model it if the photos show that it helps"),
    ("ON", "On", "Always model it"),
    ("OFF", "Off", "Never model it"),
)
_STORAGE = (
    ("PACK", "Pack", "Keep the images inside the .blend"),
    ("FILE", "Keep as Files", "Leave the images in the output folder"),
)


def _items(labels: Mapping[str, Label]) -> list[tuple[str, str, str]]:
    return [(key, label.title, label.explanation) for key, label in labels.items()]


def _choice(key: str) -> EnumProperty:
    item = component(key)
    return EnumProperty(name=item.title, description=item.explanation, items=_CHOICES)


class DANTEW_PG_settings(bpy.types.PropertyGroup):
    """Settings of the DANTE-W panel. Each component of the light has a property `model_KEY`."""

    prior_folder: StringProperty(
        name="Albedo Priors",
        description="Optional folder of albedo images named like the photos, made by an image network",
        subtype="DIR_PATH",
    )
    preset: EnumProperty(
        name="Preset", description="Quality against time", items=_items(PRESETS), default="standard"
    )
    texture_size: EnumProperty(name="Texture Size", description="Texels along a side", items=_SIZES)
    device: EnumProperty(
        name="Device", description="Where the paper's model is fitted", items=_items(DEVICES)
    )
    file_format: EnumProperty(
        name="Format", description="File format of the albedo texture", items=_items(FORMATS)
    )
    unwrap: BoolProperty(
        name="Make New UVs",
        description="Unwrap the mesh again. Use it where the UV map is missing or overlaps itself",
    )
    irradiance: EnumProperty(name="Light", description="How light is modelled", items=_items(MODELS))
    model_groups: _choice("groups")
    model_exposures: _choice("exposures")
    model_bounce: _choice("bounce")
    model_gloss: _choice("gloss")
    model_sun: _choice("sun")
    output_folder: StringProperty(
        name="Output",
        description="Folder for scene and result; empty for a folder beside the .blend",
        subtype="DIR_PATH",
    )
    storage: EnumProperty(name="Images", description="Where the result's images are kept", items=_STORAGE)
    hdri: EnumProperty(
        name="HDRI", description="Environment that lights the preview", items=hdris.enum_items()
    )
    hdri_file: StringProperty(
        name="File", description="An equirectangular .hdr or .exr file", subtype="FILE_PATH"
    )
    rotation: FloatProperty(
        name="Rotation", description="Turn the environment about the vertical axis", subtype="ANGLE"
    )
    strength: FloatProperty(
        name="Strength", description="Brightness of the environment", default=1.0, min=0.0, soft_max=5.0
    )
    samples: IntProperty(name="Samples", description="Cycles samples per pixel", default=32, min=1, max=4096)


def component_choices(settings: DANTEW_PG_settings) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keys of the components of the light that are always modelled, and of those that never are."""
    choices = {item.key: getattr(settings, f"model_{item.key}") for item in COMPONENTS}
    always, never = (
        tuple(key for key, choice in choices.items() if choice == value) for value in ("ON", "OFF")
    )
    return always, never


def preset_problem(settings: DANTEW_PG_settings) -> str | None:
    """Why the preset cannot be used with the chosen model of light, with the fix; None where it can."""
    if settings.preset in MODEL_PRESETS[settings.irradiance]:
        return None
    suitable = next(model for model, presets in MODEL_PRESETS.items() if settings.preset in presets)
    return (
        f"The preset {PRESETS[settings.preset].title} does not work with {MODELS[settings.irradiance].title}. "
        f"Choose another preset, or set Options > Light to {MODELS[suitable].title}."
    )


def settings_of(scene: bpy.types.Scene) -> DANTEW_PG_settings:
    """The settings of a scene."""
    return scene.dante_w


def register() -> None:
    """Make the settings part of every scene."""
    bpy.utils.register_class(DANTEW_PG_settings)
    bpy.types.Scene.dante_w = PointerProperty(type=DANTEW_PG_settings)


def unregister() -> None:
    """Undo `register`."""
    del bpy.types.Scene.dante_w
    bpy.utils.unregister_class(DANTEW_PG_settings)
