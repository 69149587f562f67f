"""From runs to rows: what was promised, what came out, and whether that holds."""

from __future__ import annotations

import re
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from dante_w.presets import Preset
from measure.metrics import apply_gains, gains, psnr, srgb_from_linear

from extremes.row import Row
from extremes.world import FIELD, TEXTURE, TINY, TRACED, Outcome, World, albedo_at, make, recover, write

MODELS = {"traced": TRACED, "field": FIELD}


def tried(world: World, *options: str, preset: Preset = TINY, size: int = TEXTURE) -> Outcome:
    """What the command makes of a scene; its files are removed."""
    with tempfile.TemporaryDirectory(prefix="dante-w-stability-") as folder:
        return recover(write(world, Path(folder) / "scene"), *options, preset=preset, size=size)


@cache
def unspoilt(model: str) -> Outcome:
    """The same for the scene as it is."""
    return tried(make(), *MODELS[model])


def between(outcome: Outcome, reference: Outcome, gain: bool = False) -> float:
    """PSNR in dB of sRGB albedo between two textures where both were seen, at most 99; after one gain per channel on
    request."""
    assert outcome.albedo is not None and reference.albedo is not None
    assert outcome.seen is not None and reference.seen is not None
    mask = outcome.seen & reference.seen
    if not mask.any():
        return 0.0
    found, wanted = (srgb_from_linear(each.albedo.clip(0.0, 1.0)) for each in (outcome, reference))  # type: ignore[union-attr]
    if gain:
        found = apply_gains(found, gains(found, wanted, mask))
    return min(psnr(found, wanted, mask) if (found[mask] != wanted[mask]).any() else 99.0, 99.0)


def texel_centres(size: int) -> np.ndarray:
    """(size, size, 2) texture coordinates."""
    centre = (np.arange(size) + 0.5) / size
    return np.stack(np.meshgrid(centre, 1.0 - centre), axis=-1)


def accuracy(outcome: Outcome) -> float:
    """PSNR in dB of the recovered albedo against the painted one, after one gain per channel."""
    size = len(outcome.albedo)  # type: ignore[arg-type]
    truth = albedo_at(texel_centres(size))
    return between(outcome, Outcome(0, "", {}, truth, np.ones((size, size), bool)), gain=True)


def alike(
    family: str,
    name: str,
    outcome: Outcome,
    reference: Outcome,
    least: float,
    note: str = "",
    gain: bool = False,
) -> Row:
    """The result is as near to the reference as promised, in dB, and everything on the way was finite."""
    bound = f"PSNR at least {least:g} dB to the unspoilt run" + (
        ", after one gain per channel" if gain else ""
    )
    if outcome.code:
        return Row(name, family, f"exit {outcome.code}", bound, False, outcome.message)
    value = between(outcome, reference, gain)
    holds = value >= least and not outcome.unsound
    measured = f"{value:.1f} dB" + (f"; not finite: {outcome.unsound}" if outcome.unsound else "")
    return Row(name, family, measured, bound, holds, note)


def as_good(family: str, name: str, outcome: Outcome, reference: Outcome, loss: float, note: str = "") -> Row:
    """The result is no further from the painted albedo than the reference is, but for `loss` dB."""
    wanted = accuracy(reference)
    bound = f"at most {loss:g} dB worse than the unspoilt run ({wanted:.1f} dB against the truth, after gain)"
    if outcome.code:
        return Row(name, family, f"exit {outcome.code}", bound, False, outcome.message)
    value = accuracy(outcome)
    measured = f"{value:.1f} dB" + (f"; not finite: {outcome.unsound}" if outcome.unsound else "")
    return Row(name, family, measured, bound, value >= wanted - loss and not outcome.unsound, note)


def refused(family: str, name: str, outcome: Outcome, word: str, code: int = 2) -> Row:
    """The command says in one sentence with `word` in it why it cannot."""
    sentence = outcome.message
    holds = outcome.code == code and word in sentence and "\n" not in sentence
    told = re.sub(r"/\S*/(?=scene)", "", sentence)  # not this machine's folders
    return Row(name, family, f"exit {outcome.code}", f"exit {code} and one sentence", holds, f"“{told}”")


def finite(family: str, name: str, outcome: Outcome, varied: bool = True, note: str = "") -> Row:
    """There is a result, all of it finite; `varied`: and not all of one colour."""
    bound = "a result, all finite" + (", not one grey" if varied else "")
    if outcome.code or outcome.albedo is None:
        return Row(name, family, f"exit {outcome.code}", bound, False, outcome.message)
    seen = outcome.albedo[outcome.seen]
    sound = bool(np.isfinite(outcome.albedo).all()) and not outcome.unsound
    spread = float(seen.std(axis=0).max()) if len(seen) else 0.0
    measured = "finite" if sound else f"not finite: {outcome.unsound or 'texture'}"
    if varied:
        measured += f", standard deviation {spread:.3f}"
    return Row(name, family, measured, bound, sound and len(seen) > 0 and (not varied or spread > 1e-3), note)
