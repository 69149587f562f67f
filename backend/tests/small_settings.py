"""Settings as small as the test scenes, handed to the command as `settings`."""

from __future__ import annotations

from dante_w.field.fields import ModelSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.field.presets import Preset as FieldSettings
from dante_w.presets import PRESETS, Preset
from dante_w.traced.settings import TracedSettings

SPEC = ModelSpec(GridSpec(2, 6, 2, 4, 64, 12), GridSpec(3, 2, 2, 2, 4, 10), hidden=16, embedding=4)
#: Light from fewer directions: the time to solve for it grows with their cube.
TRACED = TracedSettings(directions=32)


def small_preset(size: int, steps: int = 300, final_steps: int = 60, name: str = "standard") -> Preset:
    """Both models at the size of a test scene: textures of `size` texels, a field fitted in so many steps."""
    final = Schedule(final_steps, 2048, 2e-3)
    field = FieldSettings(size, SPEC, Schedule(steps, 2048, 1e-2), final)
    goes_on, left_out = (getattr(PRESETS[name].traced, key) for key in ("goes_on", "left_out"))
    return Preset(name, size, TracedSettings(32, left_out, goes_on), field)
