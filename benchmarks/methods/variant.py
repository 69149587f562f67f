"""The product's own command line with its presets changed, for measurements.

    python benchmarks/methods/variant.py '{"schedule.steps": 250}' recover SCENE --irradiance field --out DIR

is `dante-w recover SCENE --irradiance field --out DIR` with 250 steps. A change is a field of `Preset`, dotted where it
lies deeper; one of three things that are no setting of the product:

    ray_fraction: a random part of the traced samples, (0, 1], is all that the fit gets to see
    cache_share: part of the free memory that the ray cache may fill, [0, 1]; 0 puts it into files
    decoder_precision: "bfloat16" runs the decoders' matrix products so while fitting, not in the bake

or a number of traced light (`CONSTANTS`), which no preset has but its directions.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import torch
from dante_w.commands import cli, recover_field, recover_traced, stages
from dante_w.contract.errors import BAD_INPUT
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.presets import PRESETS, Preset
from dante_w.rays import cast_photos
from dante_w.rays.ray_cache import RayCache
from dante_w.traced import light_transport as transfer
from dante_w.traced import shading_points
from dante_w.traced.solver import solve_lights as lights
from torch import nn

#: The final pass goes with the main one, as in the presets, unless it is changed itself.
FOLLOWERS: dict[str, tuple[str, Callable[[int], int]]] = {
    "schedule.steps": ("final_pass.steps", lambda steps: steps // 4),
    "schedule.batch": ("final_pass.batch", lambda batch: batch),
}
OUTSIDE = ("ray_fraction", "cache_share", "decoder_precision")
RAY_FRACTION, CACHE_SHARE, DECODER_PRECISION = OUTSIDE
#: Directions of traced light, whatever the preset; and where its other numbers stand.
DIRECTIONS = "traced.directions"
CONSTANTS: dict[str, tuple[ModuleType, str]] = {
    "traced.rays": (transfer, "RAYS_PER_DIRECTION"),
    "traced.side": (shading_points, "SIDE"),
    "traced.points": (lights, "POINTS"),
    "traced.last_steps": (lights, "LAST_STEPS"),
}


def main(arguments: Sequence[str]) -> int:
    """Change the presets as the first argument says and hand the others to `dante-w`; returns the exit code."""
    try:
        changes = json.loads(arguments[0] if arguments else "")
        if not isinstance(changes, dict):
            raise ValueError("they are no JSON object")
        install(changes)
    except ValueError as error:
        print(f"variant: the first argument holds the changes, but {error}.", file=sys.stderr)
        return BAD_INPUT
    return cli.main(arguments[1:])


def install(changes: Mapping[str, Any]) -> None:
    """Make the changes in this process: to every preset, and to what `recover` traces and fits.

    Raises:
        ValueError: a name or value that cannot be.
    """
    changed = {name: altered(preset, changes) for name, preset in PRESETS.items()}
    PRESETS.update(changed)
    if CACHE_SHARE in changes:
        share = cast_photos.CastSettings(share_of_memory=changes[CACHE_SHARE])
        stages.cast_photos = partial(cast_photos.cast_photos, settings=share)
    fraction = changes.get(RAY_FRACTION, 1.0)
    if fraction < 1.0:
        cast = stages.cast_photos
        stages.cast_photos = lambda *arguments: thinned(cast(*arguments), fraction)
    if changes.get(DECODER_PRECISION) == "bfloat16":
        recover_field.Model = bfloat16_model  # type: ignore[assignment,misc]
    if DIRECTIONS in changes:
        recover_traced.DIRECTIONS = dict.fromkeys(PRESETS, changes[DIRECTIONS])
    for name, (module, constant) in CONSTANTS.items():
        setattr(module, constant, changes.get(name, getattr(module, constant)))


def altered(preset: Preset, changes: Mapping[str, Any]) -> Preset:
    """`preset` with its changes made, those of `OUTSIDE` checked and left aside.

    Raises:
        ValueError: a name that is none, or a value of another kind.
    """
    kinds = {name: type(value) for name, value in fields(preset).items()}
    for name, value in changes.items():
        if name == RAY_FRACTION:
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= 1.0:
                raise ValueError(f"{name} is {value!r} and must be above 0 and at most 1")
        elif name == CACHE_SHARE:
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} is {value!r} and must be from 0 to 1")
        elif name == DECODER_PRECISION:
            if value not in ("float32", "bfloat16"):
                raise ValueError(f"{name} is {value!r} and must be float32 or bfloat16")
        elif name in (DIRECTIONS, *CONSTANTS):
            if type(value) is not int or value < 1:
                raise ValueError(f"{name} is {value!r} and must be a whole number above 0")
        elif name not in kinds:
            raise ValueError(f"{name!r} is none of {', '.join([*kinds, *OUTSIDE, DIRECTIONS, *CONSTANTS])}")
        elif type(value) not in (kinds[name], int):
            raise ValueError(f"{name} is {value!r} and must be of type {kinds[name].__name__}")
    inside = {name: value for name, value in changes.items() if name in kinds}
    for name, (follower, rule) in FOLLOWERS.items():
        if name in inside:
            inside.setdefault(follower, rule(inside[name]))
    for name, value in inside.items():
        preset = _replaced(preset, name.split("."), value)
    return preset


def fields(preset: Any, prefix: str = "") -> dict[str, Any]:
    """Every number in a preset under its dotted name."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(preset):
        value = getattr(preset, field.name)
        if dataclasses.is_dataclass(value):
            found.update(fields(value, f"{prefix}{field.name}."))
        else:
            found[prefix + field.name] = value
    return found


def _replaced(part: Any, path: Sequence[str], value: Any) -> Any:
    name, *deeper = path
    return dataclasses.replace(
        part, **{name: _replaced(getattr(part, name), deeper, value) if deeper else value}
    )


def thinned(cache: RayCache, fraction: float) -> RayCache:
    """The cache with a random `fraction` of its samples, as if the photos had so many fewer pixels."""
    return cache.subset(np.flatnonzero(np.random.default_rng(0).random(len(cache)) < fraction))


class Bfloat16(nn.Sequential):
    """A decoder whose matrix products run in bfloat16 while gradients are wanted; (N, inputs) to (N, 3) float32."""

    def forward(self, encoded: torch.Tensor) -> torch.Tensor:
        with torch.autocast(encoded.device.type, torch.bfloat16, enabled=torch.is_grad_enabled()):
            raw: torch.Tensor = super().forward(encoded)
        return raw.float()  # sigmoid, softplus and the losses stay in float32


def bfloat16_model(spec: ModelSpec, photos: int) -> Model:
    """`Model` with either decoder in bfloat16; from the same seed, the same start."""
    model = Model(spec, photos)
    for field in (model.albedo, model.irradiance):
        field.decoder = Bfloat16(*field.decoder)
    return model


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
