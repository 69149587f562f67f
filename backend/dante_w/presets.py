"""The presets: for each name, how large a texture it takes at most and the settings of both models."""

from __future__ import annotations

from dataclasses import dataclass

from dante_w.contract.errors import BadInput
from dante_w.field.settings import DRAFT, HIGH, PAPER, STANDARD, FieldSettings
from dante_w.rays.cast_photos import CAST, CastSettings
from dante_w.traced.settings import TracedSettings
from dante_w.traced.shading_points import ShadingSettings


@dataclass(frozen=True)
class Preset:
    """Settings by one name.

    Attributes:
        name: one of `contract.vocabulary.PRESETS`.
        texture_size: the most texels along a side that a plan takes.
        traced: settings of traced light; None where the preset belongs to the paper's model alone.
        field: settings of the paper's model.
        cast: how photos' rays are cast.
    """

    name: str
    texture_size: int
    traced: TracedSettings | None
    field: FieldSettings
    cast: CastSettings = CAST

    def traced_settings(self) -> TracedSettings:
        """
        Raises:
            BadInput: the preset belongs to the paper's model alone.
        """
        if self.traced is None:
            raise BadInput(
                f"The preset {self.name} belongs to the paper's model: "
                "add --irradiance field, or choose draft, standard or high."
            )
        return self.traced


#: Suns take a third of `draft`'s time. `high` has four times the points and larger textures.
_ALL = (
    Preset("draft", 2048, TracedSettings(directions=64, left_out=("sun",), goes_on=True), DRAFT),
    Preset("standard", 2048, TracedSettings(), STANDARD),
    Preset("high", 8192, TracedSettings(shading=ShadingSettings(side=512)), HIGH),
    Preset("paper", 2048, None, PAPER),
)
PRESETS = {preset.name: preset for preset in _ALL}
