"""Which parts of the light a scene requires.

Whether photos differ in light and in exposure and show gloss is tried on held-out photos, with fits that cost little: few
directions, a quarter of the points; several lights and one from the start, what is tried after that by a few last steps from
the fit that has it. Bounced light follows from the mesh alone.

Several lights and one are compared with gloss or without, whichever suits each: gloss that is not there hides how much
better several lights are (a matte object: +0.2 dB with it, +14.8 without). Under one light held-out photos tell gloss:
they are re-rendered 2.3 and 3.3 dB better with it (squares summed over photos) where it is worth 4.5 and 1.7 dB of
albedo (two rendered objects), and 1.1 dB worse where it darkens what lies in the shade (a real one). Under several
lights they tell it only where they are far worse with it: on four rendered objects they wanted it off for two (by 0.7
and 1.9 dB) where it is worth 2 and 3 dB of albedo after gain, since an error of level, which they cannot tell, hurts more with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dante_w.contract.protocol import YOU_CHOSE, Decision
from dante_w.scene.held_out import choose_held_out
from dante_w.traced.held_out import place
from dante_w.traced.light_transport import LightTransport, coarser
from dante_w.traced.shading_points import Observations, ShadingPoints
from dante_w.traced.solver.solve_lights import COARSE, solve_lights
from dante_w.traced.state import Components, Lighting
from dante_w.traced.sun import PEAK, SPHERE, peaks

#: A part stays off if held-out photos gain no more than this by it, in dB; tried in this order, exposures with what is
#: modelled by then. Under one light, exposures that are all alike still gain half a dB, and are worth 0.04 dB of albedo; what
#: gloss cannot tell moves photos by hundredths there.
WORTH = {"clusters": 1.0, "specular": 0.3, "exposures": 1.0}
#: What gloss is to gain instead under several lights, where all surfaces are taken to reflect at a grazing angle: photos
#: wanted it off wrongly by up to 1.9 dB, and rightly by 16.6.
WORTH_OF_GLOSS = -4.0
#: One in this many points takes part in a trial.
ONE_IN = 4
#: Share of a point's light that comes from the mesh itself, from which on it is modelled, as a mean over points.
BOUNCED = 0.02


@dataclass(frozen=True)
class Fixed:
    """Whether a part is modelled, and why that is no question."""

    on: bool
    reason: str = YOU_CHOSE


def select_components(
    cameras: np.ndarray,
    points: ShadingPoints,
    seen: Observations,
    transfer: LightTransport,
    exposures: np.ndarray | None,
    groups: np.ndarray,
    fixed: Mapping[str, Fixed],
    seed: int,
    progress: Callable[[int, int], None],
) -> tuple[Components, list[Decision], Lighting | None]:
    """Decide what to model; returns also the lights that were found with it, if it was tried, of `COARSE` directions.

    Args:
        exposures: (K,) log exposures from the photos' files, if they tell.
        groups: (K,) a first guess of which photos share a light.
        fixed: what is decided already, by the name of the part.
    """
    few, _ = coarser(transfer, COARSE)
    fewer = seen.of(seen.point % ONE_IN == 0)
    photos = len(cameras)
    held_out = choose_held_out(photos)
    shown = fewer.of(~np.isin(fewer.photo, held_out))
    bounced = float(transfer.weight.sum() + transfer.lost.sum()) / len(points)
    parts = replace(Components(bounce=bounced >= BOUNCED), **{name: part.on for name, part in fixed.items()})
    trials = [name for name in WORTH if name not in fixed and len(held_out)]

    scores: dict[Components, float] = {}
    fits: dict[Components, Lighting] = {}

    def score(trial: Components, begun: Components | None = None) -> float:
        """By a fit from the start, or from one that has `begun`."""
        if trial not in scores:
            progress(len(scores) + 1, 2 * len(trials) + 1)
            shared = points, transfer, shown, cameras, groups, seed, _ignore, trial, None, exposures
            fits[trial] = lights = solve_lights(*shared, fits[begun] if begun else None, fine=False)
            found = place(lights, points, few, fewer, cameras, held_out, trial)[1]
            scores[trial] = -np.inf if found is None else found
        return scores[trial]

    def best(trial: Components) -> float:
        """With gloss or without, where that is open."""
        return max(
            score(trial), score(replace(trial, specular=False), trial) if "specular" in trials else -np.inf
        )

    gains: dict[str, float] = {}
    for name in trials:
        without = replace(parts, **{name: False})
        reached = best(parts) if name == "clusters" else score(parts)
        if not np.isfinite(reached):
            break
        gains[name] = reached - (best(without) if name == "clusters" else score(without, parts))
        worth = WORTH_OF_GLOSS if name == "specular" and parts.clusters else WORTH[name]
        if gains[name] <= worth:
            parts = without
    progress(1, 1)
    fit = fits.get(parts)
    brightest = float(peaks(fit).max()) if fit else None
    if brightest is not None and "sun" not in fixed:
        parts = replace(parts, sun=brightest >= PEAK * COARSE / SPHERE)
    decisions = [
        _decision(name, getattr(parts, name), fixed, gains, bounced, brightest) for name in vars(Components())
    ]
    return parts, decisions, fit


def _ignore(step: int, steps: int) -> None:
    pass


_COSTS = {
    "clusters": "seconds grow with the number of lights, squared",
    "exposures": "one number a photo",
    "bounce": "a fifth of the time for lights, 100 MB for ten million rays",
    "specular": "half of the time for lights",
    "sun": "seconds for each light that has a peak; rays of their own for its photos' pixels",
}
_ON = {
    "clusters": "several lights",
    "exposures": "one for each photo",
    "bounce": "on",
    "specular": "on",
    "sun": "looked for",
}
_OFF = {
    "clusters": "one light",
    "exposures": "one for all photos",
    "bounce": "off",
    "specular": "off",
    "sun": "none",
}


def _decision(
    name: str,
    on: bool,
    fixed: Mapping[str, Fixed],
    gains: Mapping[str, float],
    bounced: float,
    brightest: float | None,
) -> Decision:
    if name in fixed:
        reason = fixed[name].reason
    elif name == "specular" and on and gains.get(name, np.inf) <= WORTH[name]:
        reason = f"all surfaces reflect at a grazing angle, and held-out photos hardly tell: {gains[name]:+.1f} dB with it"
    elif name in gains:
        reason = f"held-out photos are re-rendered {gains[name]:+.1f} dB with it"
    elif name == "bounce":
        reason = f"{100.0 * bounced:.0f}% of what points face is the mesh itself"
    elif name == "sun" and brightest is not None:
        reason = f"the brightest part of a light is {brightest:.0f} times as bright as the mean"
    else:
        reason = "no held-out photo tells"
    return Decision(name, (_ON if on else _OFF)[name], reason, _COSTS[name])
