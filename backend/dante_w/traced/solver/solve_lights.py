"""Lights and exposures of the photos by variable projection.

A photo k sees point c as p_ck = exp(g_k) (a_c (T_c . L_j + bounce) + sheen), where j is k's light. For given lights the
best log albedo a_c of a point is found on its own, so damped Gauss-Newton steps on log L and g alone reach in a dozen
steps what gradient descent on everything does not in thousands: the problem is ill-conditioned, not large (Golub and
Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate", 1973).
The first steps, while photos still change their lights, see light from few directions: they cost little.

Colours are linear. The level of albedo, which photos leave open but bounced light and sheen need, is a prior's where there is
one; without, "top" is where the brightest albedo is taken to lie (`TOP`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from dante_w.contract.errors import BadInput
from dante_w.traced.light_clusters import reassign_photos
from dante_w.traced.light_transport import LightTransport, bounced, coarser
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.solver.normal_equations import (
    LEVEL,
    OPEN_LEVEL,
    Equations,
    ExposurePrior,
    prior_precision,
    step,
)
from dante_w.traced.solver.smoothness_prior import smoothness_laplacian
from dante_w.traced.solver.step_control import Course, look, noted, robust_cost
from dante_w.traced.solver.variable_projection import OUTLIER, by_point, project_albedo
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import ALL_COMPONENTS, FAINTEST, AlbedoPrior, Components, Lighting

#: Albedo of the brightest points, at this quantile of the largest channel: what it is taken for until the last steps,
#: and the bounds of what sheen and bounced light then say it is.
TOP, BRIGHTEST, BOUNDS = 0.5, 0.98, (0.25, 0.9)
#: Standard deviation of a photo's log exposure around the others' where the file does not tell it, and where it does.
FREE_EXPOSURE, KNOWN_EXPOSURE = 1.0, 0.1
#: Relative error of a colour that the model misses anyhow, and absolute error of a photo's linear values.
RELATIVE, ABSOLUTE = 0.04, 0.004
#: Points that Gauss-Newton steps look at. More are no better: their neighbours, which are to be even, come nearer then, and nearer
#: ones tell less (see `evenness`).
POINTS = 2500
#: Cells along either side of the texture whose points count once. Smaller ones show fewer pixels each and weigh less (`_weights`), but
#: as many of them tell no less of light: they count more.
COUNTED_SIDE = 256
FEWEST_PHOTOS = (
    3  # that must see a point, or as many as see one at most: then light stays what it is taken for at first
)
#: Directions of light in the first steps; these steps; the last steps, of which five are as good without priors, but not with them.
COARSE, FIRST_STEPS, LAST_STEPS = 64, 9, 7
#: Steps after which photos may change their light, and how well another is to explain them for a light to be given up (see
#: `regroup`): early on all explain badly, and photos of two lights that have become one do not part again.
REASSIGN = {3: 1.1, 5: 1.15, 7: 1.25}
#: The step that sets the level, and how far it is believed: on seven rendered objects the true level goes with what it finds
#: by a slope of 0.5.
LEVEL_STEP, LEVEL_TRUST = 13, 0.55
#: How many of the first steps are taken again from a fit of other parts or fewer observations; steps from a cold start before
#: sheen is modelled.
AGAIN, WITHOUT_GLOSS = 3, 2


@dataclass(frozen=True)
class Evidence:
    """The photos' observations with the directions `towards` their cameras (M, 3), their `weight` (M, 3) and `log_colour`
    (M, 3); `by_point` is their order point by point, see `projection.by_point`."""

    points: ShadingPoints
    seen: Observations
    by_point: tuple[np.ndarray, np.ndarray]
    log_colour: np.ndarray
    towards: np.ndarray
    weight: np.ndarray
    prior: AlbedoPrior
    expected: ExposurePrior
    parts: Components

    @property
    def free(self) -> bool:
        """Whether nothing is known of exposures."""
        return self.expected.deviation == FREE_EXPOSURE


def evidence(
    points: ShadingPoints,
    seen: Observations,
    cameras: np.ndarray,
    parts: Components = ALL_COMPONENTS,
    prior: AlbedoPrior | None = None,
    known_exposure: np.ndarray | None = None,
) -> Evidence:
    """What lights are to explain.

    Args:
        cameras: (K, 3) the photos' centres in the unit cube.
        prior: what is known of the albedo, if anything.
        known_exposure: (K,) log exposures from the photos' files.
    """
    count, photos = len(points), len(cameras)
    prior = prior or AlbedoPrior(np.zeros((count, 3), np.float32), np.zeros(count, np.float32))
    if not parts.exposures:
        expected = ExposurePrior(seen.levels(photos), 1e-3)
    elif known_exposure is not None:
        expected = ExposurePrior(known_exposure + seen.levels(photos), KNOWN_EXPOSURE)
    else:
        expected = ExposurePrior(np.zeros(photos), FREE_EXPOSURE)
    towards = points.towards(seen.point, cameras[seen.photo])
    order, log_colour = by_point(seen.point, count), np.log(np.maximum(seen.colour, FAINTEST))
    return Evidence(points, seen, order, log_colour, towards, _weights(seen), prior, expected, parts)


def solve_lights(
    points: ShadingPoints,
    transfer: LightTransport,
    seen: Observations,
    cameras: np.ndarray,
    light: np.ndarray,
    seed: int,
    progress: Callable[[int, int], None],
    parts: Components = ALL_COMPONENTS,
    prior: AlbedoPrior | None = None,
    known_exposure: np.ndarray | None = None,
    begun: Lighting | None = None,
    fine: bool = True,
) -> Lighting:
    """Find the lights that explain the photos, but for suns. Arguments as of `evidence`, and

    Args:
        light: (K,) a first guess of which photos share a light, rather too many lights than too few.
        begun: lights of `COARSE` directions to go on from, of other parts or fewer observations.
        fine: whether to take the last steps; without them, lights have `COARSE` directions.

    Raises:
        BadInput: too few photos see the same points.
    """
    of, count = evidence(points, seen, cameras, parts, prior, known_exposure), len(points)
    views = np.bincount(seen.point, (of.weight > 0.0).all(axis=1), count)
    enough = views >= max(min(FEWEST_PHOTOS, views.max(initial=0.0)), 1.0)
    known = enough & (transfer.direct.sum(axis=1) > 0.02)
    if not known.any():
        raise BadInput(
            "No part of the mesh is well exposed and in the light, which traced light needs; "
            "add photos or take --irradiance field."
        )
    few, part_of = coarser(transfer, COARSE)
    if begun:
        start, first = _exposed(begun, of), FIRST_STEPS - AGAIN
    else:
        start, first = _even_sky(few, of, light if parts.clusters else np.zeros_like(light)), 0
    start = replace(start, albedo=np.zeros((count, 3), np.float32), known=known, setbacks=())
    steps = FIRST_STEPS + (LAST_STEPS if fine else 0)

    def told(done: int) -> None:
        progress(done - first, steps - first)

    lights = refine(start, few, of, seed, range(first, FIRST_STEPS), told)
    if not fine:
        return lights
    lights = replace(lights, radiance=lights.radiance[:, part_of])
    return refine(lights, transfer, of, seed, range(FIRST_STEPS, steps), told)


def _even_sky(few: LightTransport, of: Evidence, light: np.ndarray) -> Lighting:
    """The same for every light: a little more from above; exposures by the photos' brightness."""
    count = len(of.points)
    sky = np.exp(0.3 * few.directions[:, 2])
    radiance = np.tile(sky[None, :, None], (light.max() + 1, 1, 3)).astype(np.float32)
    exposure = (
        _first_exposures(of.seen, of.weight, len(light)) if of.free else of.expected.mean.astype(np.float64)
    )
    bounce = np.zeros((count, len(radiance), 3), np.float32)
    return Lighting(
        radiance, light, exposure, bounce, np.zeros((count, 3), np.float32), np.zeros(count, bool)
    )


def _exposed(lights: Lighting, of: Evidence) -> Lighting:
    """With exposures as expected where these are not modelled; what photos of one light lose by that on average, it takes up."""
    if of.parts.exposures:
        return lights
    count = len(lights.radiance)
    photos = np.maximum(np.bincount(lights.cluster, minlength=count), 1)
    lost = np.bincount(lights.cluster, lights.log_exposure - of.expected.mean, count) / photos
    brighter = np.exp(lost).astype(np.float32)[:, None]
    return replace(
        lights,
        radiance=lights.radiance * brighter[:, None],
        bounce=lights.bounce * brighter,
        log_exposure=of.expected.mean.astype(np.float64),
    )


def refine(
    lights: Lighting,
    transfer: LightTransport,
    of: Evidence,
    seed: int,
    steps: range,
    progress: Callable[[int], None],
) -> Lighting:
    """Take Gauss-Newton steps, and again those that went astray, then bring albedo up to date."""
    generator = np.random.default_rng(seed)
    precision = prior_precision(transfer.directions, transfer.suns, LEVEL if of.free else OPEN_LEVEL)
    course, sound, done, again = Course(setbacks=lights.setbacks), lights, steps.start, False
    while True:
        irradiance = lights.irradiance(transfer)
        gloss = np.zeros((len(of.seen.point), 3), np.float32)
        if of.parts.specular and done >= WITHOUT_GLOSS:
            gloss = observed_specular(of, transfer, lights)
        before, (lights, told) = lights, explain(lights, irradiance, gloss, of)
        if lights.radiance is not before.radiance:  # it took up what is not albedo's
            irradiance = lights.irradiance(transfer)
        cost = robust_cost(of.weight, told.share * told.residual / OUTLIER)
        found = lights.radiance, lights.log_exposure, lights.albedo
        if again:  # known to be sound; the step from here is to be a shorter one
            again, well = False, True
        else:
            course, well = look(course, done, steps.stop, cost, found)
            sound = lights if well else sound
        if course.hopeless or (well and done == steps.stop):
            return replace(sound, setbacks=course.setbacks)
        if not well:
            lights, done, again = sound, max(done - 1, steps.start), True
            continue
        if of.parts.bounce:
            leaving = np.minimum(lights.albedo, 0.95)[:, None, :] * irradiance
            arriving = bounced(transfer, leaving.reshape(len(leaving), -1)).reshape(leaving.shape)
            lights = replace(lights, bounce=arriving)
        if done in REASSIGN and of.parts.clusters:
            light, kept = reassign_photos(
                told.over_light + np.log(irradiance)[of.seen.point, lights.cluster[of.seen.photo]],
                irradiance,
                of.weight,
                of.seen,
                lights,
                REASSIGN[done],
            )
            lights = replace(
                lights, radiance=lights.radiance[kept], cluster=light, bounce=lights.bounce[:, kept]
            )
            course = replace(course, lowest=np.inf)
        else:
            chosen = np.sort(generator.permutation(np.flatnonzero(lights.known))[:POINTS])
            even = smoothness_laplacian(of.points.position[chosen], np.log(lights.albedo[chosen]), generator)
            equations = _equations(chosen, lights, irradiance, transfer, told, of, even)
            damping = max(0.5**done, 1e-3) + course.harder
            change, shift, level, rate = step(equations, lights.log_exposure, of.expected, precision, damping)
            if rate < 1.0:
                course = noted(course, done, "the equations had no sound solution", rate)
            radiance = np.exp(np.log(lights.radiance) + change).astype(np.float32)
            lights = replace(lights, radiance=radiance, log_exposure=lights.log_exposure + shift)
            if done == LEVEL_STEP and len(lights.radiance) > 1:  # one light alone leaves it open
                lights = replace(
                    lights, brightest_albedo=float(np.clip(TOP * np.exp(LEVEL_TRUST * level), *BOUNDS))
                )
                course = replace(course, lowest=np.inf)
        done += 1
        progress(done)


@dataclass(frozen=True)
class Projection:
    """What the observations say of log albedo `over_light` (M, 3), each with the `trust` (M, 3) it deserves;
    `residual` is the rest, `share` (M, 3) of what is shown is diffuse."""

    over_light: np.ndarray
    trust: np.ndarray
    residual: np.ndarray
    share: np.ndarray


def explain(
    lights: Lighting, irradiance: np.ndarray, gloss: np.ndarray, of: Evidence
) -> tuple[Lighting, Projection]:
    """The albedo that explains the photos best under given lights; with its level, which exposures lose if they are free,
    else lights, and with a prior its tint, which lights lose."""
    log_albedo = np.log(np.maximum(lights.albedo, FAINTEST), dtype=np.float32)
    over_light, trust, residual, share = (np.empty_like(of.log_colour) for _ in range(4))
    project_albedo(
        *of.by_point,
        of.log_colour,
        of.weight,
        gloss,
        of.seen.photo,
        lights.log_exposure.astype(np.float32),
        lights.cluster,
        irradiance,
        of.prior.log_albedo,
        of.prior.weight,
        not lights.albedo.any(),
        log_albedo,
        over_light,
        trust,
        residual,
        share,
    )
    level, tint = _level(log_albedo, lights, of)
    albedo = np.exp(log_albedo + (level + tint))
    albedo[~lights.known] = np.median(albedo[lights.known], axis=0)
    found = replace(lights, albedo=albedo)
    if of.free:
        found, left = replace(found, log_exposure=lights.log_exposure - level), tint
    else:  # light has the level, then
        left = tint + np.float32(level)
    if left.any():
        whiter = np.exp(-left)
        found = replace(found, radiance=lights.radiance * whiter, bounce=lights.bounce * whiter)
    return found, Projection(over_light + (level + tint), trust, residual, share)


def _level(log_albedo: np.ndarray, lights: Lighting, of: Evidence) -> tuple[float, np.ndarray]:
    """What is to be added to log albedo, and to its channels (3,) float32: by the mean of the prior over what photos
    see, of linear albedo, since the prior's noise has no mean there; or by the rule for the brightest points, without tint."""
    photos = np.bincount(of.seen.point, minlength=len(of.points))
    trust = of.prior.weight * lights.known * photos
    if trust.any():
        told, found = (trust @ np.exp(each.astype(np.float64)) for each in (of.prior.log_albedo, log_albedo))
        channels = np.log(told / found)
        return float(channels.mean()), np.asarray(channels - channels.mean(), np.float32)
    level = np.log(lights.brightest_albedo) - np.quantile(log_albedo[lights.known].max(axis=1), BRIGHTEST)
    return float(level), np.zeros(3, np.float32)


def _equations(
    chosen: np.ndarray,
    lights: Lighting,
    irradiance: np.ndarray,
    transfer: LightTransport,
    told: Projection,
    of: Evidence,
    even: torch.Tensor,
) -> Equations:
    """The observations of the chosen points, and how far these are to be `even`."""
    renumbered = np.full(len(of.points), -1)
    renumbered[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(renumbered[of.seen.point] >= 0)
    known = np.repeat(of.prior.weight[chosen, None], 3, axis=1)
    light = lights.cluster[of.seen.photo[rows]]
    bounced_share = lights.bounce[of.seen.point[rows], light] / irradiance[of.seen.point[rows], light]
    return Equations(
        point=renumbered[of.seen.point[rows]],
        photo=of.seen.photo[rows],
        weight=told.trust[rows],
        residual=told.residual[rows],
        direct=transfer.direct[chosen],
        irradiance=irradiance[chosen],
        radiance=lights.radiance,
        light=lights.cluster,
        level=bounced_share - (1.0 / told.share[rows] - 1.0),
        known=known,
        known_residual=of.prior.log_albedo[chosen] - np.log(lights.albedo[chosen]),
        log_albedo=np.log(lights.albedo[chosen]),
        even=even,
        suns=transfer.suns,
        counts=max(of.points.side / COUNTED_SIDE, 1.0),
    )


def observed_specular(of: Evidence, transfer: LightTransport, lights: Lighting) -> np.ndarray:
    """(M, 3) what the observations owe to gloss."""
    return specular_radiance(
        of.seen.point,
        lights.cluster[of.seen.photo],
        of.towards,
        of.points.normal,
        transfer,
        lights.radiance,
    )


def _weights(seen: Observations) -> np.ndarray:
    """(M, 3) how far each observation is to be trusted, about 1 for a mid grey; 0 where it is clipped."""
    dark = (ABSOLUTE / np.maximum(seen.colour, 1e-4)) ** 2
    weight = np.minimum(seen.pixels, 4)[:, None] * RELATIVE**2 / (RELATIVE**2 + dark)
    return np.where(seen.clipped[:, None], 0.0, weight).astype(np.float32)


def _first_exposures(seen: Observations, weight: np.ndarray, photos: int) -> np.ndarray:
    """(K,) each photo's mean log brightness, with mean 0."""
    brightness = np.log(np.maximum(seen.colour, FAINTEST)).mean(axis=1)
    trust = weight.mean(axis=1) + 1e-9
    total = np.bincount(seen.photo, trust, photos)
    mean = np.bincount(seen.photo, trust * brightness, photos) / np.maximum(total, 1e-9)
    return np.where(total > 0.0, mean - mean[total > 0.0].mean(), 0.0)
