"""Which components of the light a scene requires.

Whether photos differ in light and in exposure and show specular reflection is tried on held-out photos, with fits that cost
little: few directions, a quarter of the points; several lights and one from the start, what is tried after that by a few last
steps from the fit that has it. Bounced light follows from the mesh alone.

Several lights and one are compared with specular reflection or without, whichever suits each: reflection that is not there hides
how much better several lights are. Under one light held-out photos tell whether there is some. Under several lights they tell it
only where they are far worse with it, since an error of the albedo's scale, which they cannot tell, hurts more with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dante_w.contract.protocol import YOU_CHOSE, Decision
from dante_w.scene.held_out import choose_held_out
from dante_w.traced.held_out import USUAL_HELD_OUT, HeldOutSettings, fit_held_out
from dante_w.traced.light_transport import coarser
from dante_w.traced.solver.evidence import gather_evidence
from dante_w.traced.solver.settings import USUAL_SOLVER, SolverSettings
from dante_w.traced.solver.solve_lights import solve_lights
from dante_w.traced.state import Components, Lighting, TracedScene
from dante_w.traced.sun import USUAL_SUN, SunSettings, least_peak, peaks


@dataclass(frozen=True)
class SelectionSettings:
    """What a component has to be worth, in dB of held-out photos. Chosen on rendered objects and a real capture, see
    docs/benchmarks.md.

    Attributes:
        clusters: several lights instead of one.
        specular: under one light.
        exposures: one for each photo; exposures that are all alike still gain half a dB.
        specular_of_several: under several lights, where all surfaces are taken to reflect at a grazing angle: photos want it
            off wrongly by a little, and rightly by far more.
        one_in: one in this many points takes part in a trial.
        bounced: mean share of a point's light that comes from the mesh itself, from which on that is modelled.
        held_out: how held-out photos are scored.
    """

    clusters: float = 1.0
    specular: float = 0.3
    exposures: float = 1.0
    specular_of_several: float = -4.0
    one_in: int = 4
    bounced: float = 0.02
    held_out: HeldOutSettings = USUAL_HELD_OUT


USUAL_SELECTION = SelectionSettings()
#: Components that are tried, in this order; exposures with what is modelled by then.
TRIED = ("clusters", "specular", "exposures")


@dataclass(frozen=True)
class Fixed:
    """Whether a component is modelled, and why that is not tried."""

    on: bool
    reason: str = YOU_CHOSE


@dataclass(frozen=True)
class Selection:
    """What is modelled, why, and the lighting that was found with it, with few directions, if it was tried."""

    components: Components
    decisions: list[Decision]
    lighting: Lighting | None


def select_components(
    scene: TracedScene,
    fixed: Mapping[str, Fixed],
    seed: int,
    progress: Callable[[int, int], None],
    settings: SelectionSettings = USUAL_SELECTION,
    solver: SolverSettings = USUAL_SOLVER,
    sun: SunSettings = USUAL_SUN,
) -> Selection:
    """Decide what to model.

    Args:
        fixed: what is decided already, by the name of the component.
        progress: is told how many trials are done, and of how many.
    """
    observations = scene.observations
    fewer = observations.take(observations.point % settings.one_in == 0)
    few_directions, _ = coarser(scene.transport, solver.coarse_directions)
    coarse = replace(scene, transport=few_directions, observations=fewer)
    held_out = choose_held_out(len(scene.cameras))
    shown = fewer.take(~np.isin(fewer.photo, held_out))
    bounced = float(scene.transport.weight.sum() + scene.transport.lost.sum()) / len(scene.points)
    by_user = {name: each.on for name, each in fixed.items()}
    components = replace(Components(bounce=bounced >= settings.bounced), **by_user)
    trials = [name for name in TRIED if name not in fixed and len(held_out)]

    scores: dict[Components, float] = {}
    fits: dict[Components, Lighting] = {}

    def score(trial: Components, start: Components | None = None) -> float:
        """By a fit from the beginning, or from the one that has `start`."""
        if trial not in scores:
            progress(len(scores) + 1, 2 * len(trials) + 1)
            evidence = gather_evidence(
                scene.points, shown, scene.cameras, solver.evidence, trial, known_exposure=scene.exposures
            )
            first = fits[start] if start else scene.clusters
            fits[trial] = lighting = solve_lights(
                evidence, scene.transport, first, solver, seed, _ignore, fine=False
            )
            reached = fit_held_out(lighting, coarse, held_out, trial, settings.held_out)[1]
            scores[trial] = -np.inf if reached is None else reached
        return scores[trial]

    def best(trial: Components) -> float:
        """With specular reflection or without, where that is open."""
        matte = replace(trial, specular=False)
        return max(score(trial), score(matte, trial) if "specular" in trials else -np.inf)

    gains: dict[str, float] = {}
    for name in trials:
        without = replace(components, **{name: False})
        reached = best(components) if name == "clusters" else score(components)
        if not np.isfinite(reached):
            break
        gains[name] = reached - (best(without) if name == "clusters" else score(without, components))
        several = name == "specular" and components.clusters
        worth = settings.specular_of_several if several else getattr(settings, name)
        if gains[name] <= worth:
            components = without
    progress(1, 1)
    fit = fits.get(components)
    brightest = float(peaks(fit).max()) if fit else None
    if brightest is not None and "sun" not in fixed:
        components = replace(components, sun=brightest >= least_peak(solver.coarse_directions, sun))
    evidence = _Evidence(gains, bounced, brightest)
    decisions = [
        _decision(name, getattr(components, name), fixed, evidence, settings) for name in vars(components)
    ]
    return Selection(components, decisions, fit)


def _ignore(step: int, steps: int) -> None:
    pass


@dataclass(frozen=True)
class _Evidence:
    """What the decisions rest on: `gains` in dB of held-out photos by component, the `bounced` share of light, and how many times as
    bright as its mean the `brightest` part of a light is."""

    gains: Mapping[str, float]
    bounced: float
    brightest: float | None


_COSTS = {
    "clusters": "time grows with the square of the number of lights",
    "exposures": "one number a photo",
    "bounce": "a fifth of the time for lights, 100 MB for ten million rays",
    "specular": "half of the time for lights",
    "sun": "seconds for each light that has one, and rays for each pixel of its photos",
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
    name: str, on: bool, fixed: Mapping[str, Fixed], evidence: _Evidence, settings: SelectionSettings
) -> Decision:
    gain = evidence.gains.get(name)
    if name in fixed:
        reason = fixed[name].reason
    elif name == "specular" and on and gain is not None and gain <= settings.specular:
        reason = (
            "all surfaces reflect at grazing angles, so it stays on, although photos left out for checking "
            f"are predicted {gain:+.1f} dB with it"
        )
    elif gain is not None:
        reason = f"photos left out for checking are predicted {gain:+.1f} dB better with it"
    elif name == "bounce":
        reason = f"{100.0 * evidence.bounced:.0f}% of what the surface faces is the mesh itself"
    elif name == "sun" and evidence.brightest is not None:
        reason = f"the brightest part of a light is {evidence.brightest:.0f} times as bright as its mean"
    else:
        reason = "too few photos to check"
    return Decision(name, (_ON if on else _OFF)[name], reason, _COSTS[name])
