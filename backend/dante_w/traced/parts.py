"""Which parts of the light a scene requires.

Whether photos differ in light and in exposure is tried on held-out photos, with fits that cost little: few directions,
a quarter of the points. Bounced light follows from the mesh alone. Gloss does not: on four rendered objects held-out
photos wanted it off for two (by 0.7 and 1.9 dB of the photos) where it is worth 2 and 3 dB of albedo after gain, since an error of level,
which they cannot tell, hurts more with it. All surfaces reflect at a grazing angle, so it is on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dante_w.model.held_out import choose_held_out
from dante_w.traced.held_out import place
from dante_w.traced.lights import COARSE, Parts, solve_lights
from dante_w.traced.shading_points import Observations, ShadingPoints
from dante_w.traced.transfer import Transfer, coarser

#: A part stays off if held-out photos gain no more than this by it, in dB: under one light, exposures that are all alike
#: still gain half a dB, and are worth 0.04 dB of albedo.
WORTH = 1.0
#: One in this many points takes part in a trial.
ONE_IN = 4
#: Share of a point's light that comes from the mesh itself, from which on it is modelled, as a mean over points.
BOUNCED = 0.02


@dataclass(frozen=True)
class Decision:
    """One line of the plan: `what` is decided, the `choice`, the `reason`, and what it `costs`."""

    what: str
    choice: str
    reason: str
    costs: str


def choose_parts(
    cameras: np.ndarray,
    points: ShadingPoints,
    seen: Observations,
    transfer: Transfer,
    exposures: np.ndarray | None,
    groups: np.ndarray,
    fixed: Mapping[str, bool],
    seed: int,
    progress: Callable[[int, int], None],
) -> tuple[Parts, list[Decision]]:
    """Decide what to model.

    Args:
        exposures: (K,) log exposures from the photos' files, if they tell.
        groups: (K,) a first guess of which photos share a light.
        fixed: what the user has decided, by the name of the part.
    """
    few, _ = coarser(transfer, COARSE)
    fewer = seen.of(seen.point % ONE_IN == 0)
    photos = len(cameras)
    held_out = choose_held_out(photos)
    shown = fewer.of(~np.isin(fewer.photo, held_out))
    bounced = float(transfer.weight.sum() + transfer.lost.sum()) / len(points)
    parts = replace(Parts(bounce=bounced >= BOUNCED), **fixed)
    trials = [name for name in ("groups", "exposures") if name not in fixed and len(held_out)]

    def score(trial: Parts) -> float:
        lights = solve_lights(
            points, transfer, shown, cameras, groups, seed, _ignore, trial, None, exposures, fine=False
        )
        found = place(lights, points, few, fewer, cameras, held_out, trial)[1]
        return -np.inf if found is None else found

    best = score(parts) if trials else -np.inf
    if not np.isfinite(best):
        trials = []
    gains: dict[str, float] = {}
    for done, name in enumerate(trials):
        progress(done + 1, len(trials) + 1)
        without = score(replace(parts, **{name: False}))
        gains[name] = best - without
        if gains[name] <= WORTH:
            parts, best = replace(parts, **{name: False}), without
    progress(1, 1)
    return parts, [_decision(name, getattr(parts, name), fixed, gains, bounced) for name in vars(Parts())]


def _ignore(step: int, steps: int) -> None:
    pass


_COSTS = {
    "groups": "seconds grow with the number of lights, cubed",
    "exposures": "one number a photo",
    "bounce": "a fifth of the time for lights, 100 MB for ten million rays",
    "gloss": "half of the time for lights",
}
_ON = {"groups": "several lights", "exposures": "one for each photo", "bounce": "on", "gloss": "on"}
_OFF = {"groups": "one light", "exposures": "one for all photos", "bounce": "off", "gloss": "off"}


def _decision(
    name: str, on: bool, fixed: Mapping[str, bool], gains: Mapping[str, float], bounced: float
) -> Decision:
    if name in fixed:
        reason = "you chose it"
    elif name in gains:
        reason = f"held-out photos are re-rendered {gains[name]:+.1f} dB with it"
    elif name == "bounce":
        reason = f"{100.0 * bounced:.0f}% of what points face is the mesh itself"
    elif name == "gloss":
        reason = "all surfaces reflect at a grazing angle, and photos cannot tell it from the level of albedo"
    else:
        reason = "no held-out photo tells"
    return Decision(name, (_ON if on else _OFF)[name], reason, _COSTS[name])
