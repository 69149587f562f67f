"""What the user can set; saved with the scene."""

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from . import hdris

PRESETS = (
    ("draft", "Draft", "A first look"),
    ("standard", "Standard", "The usual choice"),
    ("high", "High", "Light at four times as many points, and larger textures"),
    ("paper", "Paper", "The settings of the DANTE-W paper: needs albedo priors, slow without a GPU"),
)
SIZES = [
    ("AUTO", "Automatic", "As large as the photos' pixels ask for, within the preset's bounds"),
    *((str(n), str(n), "") for n in (1024, 2048, 4096, 8192, 16384)),
]
DEVICES = (
    ("auto", "Automatic", "A GPU where there is one"),
    ("cpu", "CPU", ""),
    ("cuda", "CUDA", "An NVIDIA GPU"),
    ("mps", "Metal", "An Apple GPU"),
)
FORMATS = (
    ("png", "PNG", "8 bits a channel"),
    ("png16", "PNG 16", "16 bits a channel"),
    ("exr", "OpenEXR", "Linear, floating point"),
)
IRRADIANCE = (
    (
        "traced",
        "Traced",
        "Light traced through the mesh: lights and exposures are solved for, then the albedo",
    ),
    ("field", "Paper's Field", "The paper's model: albedo and irradiance are two fields, fitted together"),
)
CHOICES = (
    ("AUTO", "Automatic", "As the plan finds it worth while"),
    ("ON", "On", "Model it whatever the plan finds"),
    ("OFF", "Off", "Do not model it"),
)
#: Parts of the light as the backend names them, with the panel's words.
PARTS = {
    "groups": ("Several Lights", "Whether photos differ in their light"),
    "exposures": ("Exposures", "Whether photos differ in their exposure"),
    "bounce": ("Bounced Light", "Light that comes from the mesh itself"),
    "gloss": ("Gloss", "What the surface shines beside its diffuse colour"),
    "sun": ("Sun", "A light of its own that throws sharp shadows"),
}
STORAGE = (
    ("PACK", "Pack", "Keep the images inside the .blend"),
    ("FILE", "Keep as Files", "Leave the images in the output folder"),
)


def _choice(part: str) -> EnumProperty:
    name, text = PARTS[part]
    return EnumProperty(name=name, description=text, items=CHOICES)


class DANTEW_PG_settings(bpy.types.PropertyGroup):
    """Settings of the DANTE-W panel."""

    prior_folder: StringProperty(
        name="Priors",
        description="Optional folder of albedo images, named like the photos, from an image network",
        subtype="DIR_PATH",
    )
    preset: EnumProperty(name="Preset", description="Quality against time", items=PRESETS, default="standard")
    texture_size: EnumProperty(name="Texture", description="Texels a side", items=SIZES)
    device: EnumProperty(name="Device", description="What computes", items=DEVICES)
    file_format: EnumProperty(name="Format", description="File format of the albedo texture", items=FORMATS)
    unwrap: BoolProperty(
        name="Make New UVs",
        description="Unwrap the mesh anew, where its UV map is missing or overlaps itself",
    )
    irradiance: EnumProperty(name="Light", description="How light is modelled", items=IRRADIANCE)
    model_groups: _choice("groups")
    model_exposures: _choice("exposures")
    model_bounce: _choice("bounce")
    model_gloss: _choice("gloss")
    model_sun: _choice("sun")
    output_folder: StringProperty(
        name="Output",
        description="Where scene and result folders go; a folder beside the .blend if empty",
        subtype="DIR_PATH",
    )
    storage: EnumProperty(name="Images", description="Where the result's images live", items=STORAGE)
    hdri: EnumProperty(name="HDRI", description="Light to preview under", items=hdris.enum_items())
    hdri_file: StringProperty(name="File", description="An equirectangular .hdr or .exr", subtype="FILE_PATH")
    rotation: FloatProperty(name="Rotation", description="Turn the light about the vertical", subtype="ANGLE")
    strength: FloatProperty(
        name="Strength", description="Brightness of the light", default=1.0, min=0.0, soft_max=5.0
    )
    samples: IntProperty(name="Samples", description="Cycles samples a pixel", default=32, min=1, max=4096)


def parts(settings: DANTEW_PG_settings) -> dict[str, list[str]]:
    """Which parts of the light to `model` and which to `leave_out`, whatever the plan finds; the paper's field has none."""
    if settings.irradiance != "traced":
        return {}
    chosen = {part: getattr(settings, f"model_{part}") for part in PARTS}
    return {
        word: [part for part, choice in chosen.items() if choice == wanted]
        for word, wanted in (("model", "ON"), ("leave_out", "OFF"))
    }


def of(scene: bpy.types.Scene) -> DANTEW_PG_settings:
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
