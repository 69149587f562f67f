"""The words of options, reports and the panel.

A *name* is what the code and people use. A *key* is what stands in JSON and in saved .blend files; keys never change, so
that old reports and scenes stay readable. Where a key is older than its name, both are accepted on the command line.

The order of the dictionaries is fixed as well: a .blend file stores the number of a chosen value, not its key.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Label:
    """How a value of an option is shown to people: its `title` in a menu and an `explanation` without a full stop."""

    title: str
    explanation: str


PRESETS = {
    "draft": Label("Draft", "A first look: fewer directions of light and no suns"),
    "standard": Label("Standard", "The usual choice"),
    "high": Label("High", "Slower: four times as many shading points, textures up to 8192 texels a side"),
    "paper": Label(
        "Paper",
        "The settings of the DANTE-W paper, for the paper's model only: needs albedo priors, slow without a GPU",
    ),
}
#: How light is modelled.
MODELS = {
    "traced": Label(
        "Traced Light",
        "Light is traced through the mesh, with shadows and bounced light. Needs no albedo priors",
    ),
    "field": Label(
        "The Paper's Model",
        "Two neural fields, albedo and irradiance, are fitted together. Better with albedo priors",
    ),
}
#: The presets of each model of light.
MODEL_PRESETS = {"traced": ("draft", "standard", "high"), "field": tuple(PRESETS)}
FORMATS = {
    "png": Label("PNG 8 bit", "sRGB, 8 bits per channel"),
    "png16": Label("PNG 16 bit", "sRGB, 16 bits per channel"),
    "exr": Label("OpenEXR", "Linear, 16-bit floating point"),
}
#: What the paper's model computes on; traced light runs on the CPU.
DEVICES = {
    "auto": Label("Automatic", "A GPU if one works, otherwise the CPU"),
    "cpu": Label("CPU", "All cores of the processor"),
    "cuda": Label("CUDA", "An NVIDIA GPU"),
    "mps": Label("Metal", "An Apple GPU"),
}
#: Texels along a side of a texture.
LARGEST_TEXTURE = 16384


@dataclass(frozen=True)
class Component:
    """One part of the light that traced light models or leaves out.

    Attributes:
        name: the field's word, on the command line and in Python.
        key: in report.json (`parts`), `--model` and .blend properties (`model_KEY`).
        title, explanation: for people.
    """

    name: str
    key: str
    title: str
    explanation: str


#: Components of traced light, in the order in which a plan shows them.
COMPONENTS = (
    Component("clusters", "groups", "Several Lights", "Photos were taken under several different lights"),
    Component("exposures", "exposures", "Exposures", "Photos have different exposures"),
    Component("bounce", "bounce", "Bounced Light", "Light that the mesh reflects onto itself"),
    Component(
        "specular",
        "gloss",
        "Specular",
        "Highlights: light that the surface reflects without taking on its colour",
    ),
    Component("sun", "sun", "Sun", "A small, strong light that casts sharp shadows"),
)

#: Stages of a run by model, in their order, as they stand in JSON lines and in the report's `seconds`.
STAGES = {
    "traced": ("scene", "unwrap", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"),
    "field": ("scene", "unwrap", "rays", "optimise", "held-out", "final pass", "bake", "write"),
}
#: The stage whose key is older than its name.
LIGHT_TRANSPORT = "transfer"
_STAGE_TITLES = {
    "scene": "Reading the scene",
    "unwrap": "Making UVs",
    "rays": "Casting rays",
    LIGHT_TRANSPORT: "Tracing light",
    "plan": "Planning",
    "lights": "Solving for lights",
    "albedo": "Computing albedo",
    "optimise": "Fitting",
    "held-out": "Checking held-out photos",
    "final pass": "Fitting all photos",
    "bake": "Baking",
    "write": "Writing files",
}


def component(word: str) -> Component:
    """The component with this name or key.

    Raises:
        KeyError: there is none.
    """
    for item in COMPONENTS:
        if word in (item.name, item.key):
            return item
    raise KeyError(word)


def stage_title(stage: str) -> str:
    """What a stage does, for people.

    >>> stage_title("lights"), stage_title("some new stage")
    ('Solving for lights', 'Some new stage')
    """
    return _STAGE_TITLES.get(stage, stage.capitalize())


def decision_title(what: str) -> str:
    """What a line of the plan decides, for people; old reports have keys of components there.

    >>> decision_title("gloss"), decision_title("texture")
    ('Specular', 'Texture')
    """
    try:
        return component(what).title
    except KeyError:
        return what.capitalize()
