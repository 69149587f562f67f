"""The words of options, reports and the panel.

A *name* is what the code and people use. A *key* is what stands in JSON and in saved .blend files; keys never change, so
that old reports and scenes stay readable. Where a key is older than its name, both are accepted on the command line.
"""

from __future__ import annotations

from dataclasses import dataclass

PRESETS = ("draft", "standard", "high", "paper")
#: How irradiance is modelled: light traced through the mesh, or the paper's field over space.
MODELS = ("traced", "field")
FORMATS = ("png", "png16", "exr")
DEVICES = ("auto", "cpu", "cuda", "mps")
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
        "specular", "gloss", "Specular", "Reflections of the light on the surface, beside its own colour"
    ),
    Component("sun", "sun", "Sun", "A small, strong light that throws sharp shadows"),
)

#: Stages of a run by model, in their order, as they stand in JSON lines and in the report's `seconds`.
STAGES = {
    "traced": ("scene", "unwrap", "rays", "transfer", "plan", "lights", "albedo", "bake", "write"),
    "field": ("scene", "unwrap", "rays", "optimise", "held-out", "final pass", "bake", "write"),
}
#: The stage whose key is older than its name.
LIGHT_TRANSPORT = "transfer"


def component(word: str) -> Component:
    """The component with this name or key.

    Raises:
        KeyError: there is none.
    """
    for each in COMPONENTS:
        if word in (each.name, each.key):
            return each
    raise KeyError(word)
