"""Settings as small as the test scenes, handed to the command as `settings`."""

from __future__ import annotations

import dataclasses

from dante_w.field.fields import FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.field.settings import FieldSettings
from dante_w.presets import PRESETS, Preset
from dante_w.traced.settings import TracedSettings
from dante_w.traced.solver.settings import SolverSettings

SPEC = FieldSpec(GridSpec(2, 6, 2, 4, 64, 12), GridSpec(3, 2, 2, 2, 4, 10), hidden=16, embedding=4)
#: Light from fewer directions: the time to solve for it grows with their cube.
TRACED = TracedSettings(directions=32, solver=SolverSettings(coarse_directions=16))


def small_preset(size: int, steps: int = 300, final_steps: int = 60, name: str = "standard") -> Preset:
    """Both models at the size of a test scene: textures of `size` texels, a field fitted in so many steps."""
    final = Schedule(final_steps, 2048, 2e-3)
    field = FieldSettings(SPEC, Schedule(steps, 2048, 1e-2), final)
    goes_on, left_out = (getattr(PRESETS[name].traced, key) for key in ("goes_on", "left_out"))
    traced = dataclasses.replace(TRACED, left_out=left_out, goes_on=goes_on)
    return Preset(name, size, traced, field)
