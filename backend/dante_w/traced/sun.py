"""The sun as a light of its own: a direction that is far smaller than the parts that the sphere is cut into.

A light has one if its photos are explained better by it: how much of the sum of squares that Gauss-Newton steps lower does
the best direction near the brightest part of the sphere take away, and how much the part that it lies in, whose shadows are
blurred? Both are asked in closed form, beside a change of the peak's own brightness, with the log of albedo eliminated and
pairs of neighbouring points even, as in `normal_equations`. Shadows' edges tell the direction; a surface that throws none
has no need of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dante_w.core.arrays import sums
from dante_w.rays.raycast import Raycaster
from dante_w.traced.light_transport import LightTransport, sun_visibility, with_suns
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.solver.smoothness_prior import agreement
from dante_w.traced.solver.solve_lights import (
    FIRST_STEPS,
    LAST_STEPS,
    Evidence,
    Projection,
    explain,
    observed_specular,
    refine,
)
from dante_w.traced.state import FAINTEST, Lighting

#: Of `SPHERE` parts, the brightest one is to be this much brighter than the mean.
PEAK, SPHERE = 16.0, 256
#: Angles (radians) of the rings of directions that are tried, each around the best so far.
RINGS, AROUND = (0.15, 0.08, 0.04, 0.02), 8
#: What a sun takes from is the light of parts whose direction has this cosine with the brightest one's.
NEAR = 0.9
#: That light is left with this share at least.
DIMMEST = 0.05
#: A sun pays by this share of its light's sum of squares, or it is none.
PAYS = 0.015
#: Radiance of the suns that other lights have.
NONE = 1e-9
#: Steps with suns, after those without.
STEPS = range(FIRST_STEPS + LAST_STEPS, FIRST_STEPS + LAST_STEPS + 3)
#: How far neighbouring cells of the texture are to be even, beside photos' observations; and how near they have to lie, in
#: median distances.
EVEN, ADJACENT = 3.0, 3.0


@dataclass(frozen=True)
class Sun:
    """Of `light`: `direction` (3,), `radiance` (3,) in the unit of the sphere's parts, and what the light that comes `near` it
    (D,) bool is multiplied with (3,)."""

    light: int
    direction: np.ndarray
    radiance: np.ndarray
    near: np.ndarray
    dimmed: np.ndarray


def find_and_add_suns(
    of: Evidence, transfer: LightTransport, lights: Lighting, caster: Raycaster, seed: int
) -> tuple[LightTransport, Lighting]:
    """The same transfer and lights, with suns in them and refined where lights have suns."""
    gloss = observed_specular(of, transfer, lights) if of.parts.specular else np.zeros_like(of.weight)
    told = explain(lights, lights.irradiance(transfer), gloss, of)[1]
    suns = find_suns(of.points, transfer, of.seen, lights, told, caster)
    if not suns:
        return transfer, lights
    transfer, lights = add_suns(suns, of.points, transfer, lights, caster)
    return transfer, refine(lights, transfer, of, seed, STEPS, lambda _: None)


def peaks(lights: Lighting) -> np.ndarray:
    """(J,) how much brighter than the mean the brightest part of each light's sphere is."""
    brightness = lights.radiance.mean(axis=2)
    return np.asarray(brightness.max(axis=1) / brightness.mean(axis=1))


def find_suns(
    points: ShadingPoints,
    transfer: LightTransport,
    seen: Observations,
    lights: Lighting,
    told: Projection,
    caster: Raycaster,
) -> list[Sun]:
    """The suns of the lights, at most one each."""
    found = []
    for light in np.flatnonzero(peaks(lights) >= PEAK * transfer.parts / SPHERE):
        problem = _problem(points, transfer, seen, lights, told, int(light))
        sun = _search(problem, points, transfer, caster)
        if sun is not None:
            found.append(sun)
    return found


def add_suns(
    suns: list[Sun], points: ShadingPoints, transfer: LightTransport, lights: Lighting, caster: Raycaster
) -> tuple[LightTransport, Lighting]:
    """The same transfer and lights with the suns in them."""
    wider = with_suns(transfer, points, caster, np.stack([sun.direction for sun in suns]))
    shape = (len(lights.radiance), len(suns), 3)
    radiance = np.concatenate([lights.radiance, np.full(shape, NONE, np.float32)], axis=1)
    for number, sun in enumerate(suns):
        radiance[sun.light, : -len(suns)][sun.near] *= sun.dimmed
        radiance[sun.light, transfer.parts + number] = sun.radiance
    return wider, replace(lights, radiance=radiance.astype(np.float32))


@dataclass(frozen=True)
class _Problem:
    """One light's equations in the brightness of its peak and of a sun. Of the points: `irradiance` (C, 3), `trust` (C, 3) of
    the light's photos, their share `part` (C, 3) in what all photos say, the sum `pull` (C, 3) of their trust times
    residual, `peak` (C, 3) the share of the light `near` the brightest `direction`; `pairs` (P, 2) of neighbours with
    `even` (P,) and the `step` (P, 3) in log albedo between them; the `cost` now; what light of 1 from a direction adds (`share`)."""

    light: int
    irradiance: np.ndarray
    trust: np.ndarray
    part: np.ndarray
    pull: np.ndarray
    peak: np.ndarray
    direction: np.ndarray
    near: np.ndarray
    pairs: np.ndarray
    even: np.ndarray
    step: np.ndarray
    cost: float
    share: float


def _problem(
    points: ShadingPoints,
    transfer: LightTransport,
    seen: Observations,
    lights: Lighting,
    told: Projection,
    light: int,
) -> _Problem:
    count = len(points)
    known = lights.known[:, None]
    mine = lights.cluster[seen.photo] == light
    point, trust = seen.point[mine], told.trust[mine]
    pulled = trust * told.residual[mine]
    irradiance = lights.irradiance(transfer)[:, light]
    own = sums(trust, point, count) * known
    part = own / (sums(told.trust, seen.point, count) + 1e-9)
    brightest = transfer.directions[lights.radiance[light].mean(axis=1).argmax()]
    near = transfer.directions @ brightest > NEAR
    peak = np.einsum("cd,dx->cx", transfer.direct[:, near], lights.radiance[light][near]) / irradiance
    pairs = _neighbours(points)
    pairs = pairs[lights.known[pairs].all(axis=1)]
    log_albedo = np.log(np.maximum(lights.albedo, FAINTEST))
    step = log_albedo[pairs[:, 0]] - log_albedo[pairs[:, 1]]
    even = EVEN * agreement(step)
    uneven = np.square(part[pairs].mean(axis=1) * step).sum(axis=1)
    told_by_others = 1.0 - part[point]
    cost = float((told_by_others * pulled * told.residual[mine]).sum() + even @ uneven)
    pull = sums(pulled, point, count) * known
    return _Problem(
        light, irradiance, own, part, pull, peak, brightest, near, pairs, even, step, cost, transfer.share
    )


def _search(of: _Problem, points: ShadingPoints, transfer: LightTransport, caster: Raycaster) -> Sun | None:
    """The best sun near the light's peak, if it pays."""
    best, centre, change = -np.inf, of.direction.astype(np.float64), np.zeros((3, 2))
    for number, angle in enumerate(RINGS):
        around = _ring(centre, angle)
        for direction in around if number else [centre, *around]:
            facing = np.maximum(points.normal @ direction, 0.0)
            column = (facing * sun_visibility(points.position, points.normal, caster, direction))[:, None]
            gain, answer = _gain(of, column)
            if gain > best:
                best, centre, change = gain, direction, answer
    blurred = transfer.direct[:, [(transfer.directions @ centre).argmax()]] / transfer.share
    if best - _gain(of, blurred)[0] <= PAYS * of.cost or not (change[:, 1] > 0.0).all():
        return None
    return Sun(of.light, centre, change[:, 1] / of.share, of.near, np.maximum(1.0 + change[:, 0], DIMMEST))


def _gain(of: _Problem, column: np.ndarray) -> tuple[float, np.ndarray]:
    """By how much the sum of squares falls at best, and the changes (3, 2) of the peak and of a sun that do it.

    Args:
        column: (C, 1) irradiance of the points under a sun of 1.
    """
    total, answers = 0.0, np.zeros((3, 2))
    for channel in range(3):
        answer = np.column_stack([of.peak[:, channel], column[:, 0] / of.irradiance[:, channel]]).astype(
            float
        )
        moved = answer * of.part[:, channel, None]
        uneven = moved[of.pairs[:, 0]] - moved[of.pairs[:, 1]]
        data = of.trust[:, channel] * (1.0 - of.part[:, channel])
        matrix = (answer * data[:, None]).T @ answer + (uneven * of.even[:, None]).T @ uneven
        right = answer.T @ of.pull[:, channel] + uneven.T @ (of.even * of.step[:, channel])
        answers[channel] = _bounded(matrix, right)
        total += float(2.0 * right @ answers[channel] - answers[channel] @ matrix @ answers[channel])
    return total, answers


def _bounded(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The best (peak, sun) of a quadratic where a peak cannot lose more than all of it, nor a sun be negative."""
    diagonal = np.maximum(matrix.diagonal(), 1e-9)
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] ** 2
    if determinant > 1e-6 * diagonal[0] * diagonal[1]:
        both = np.linalg.solve(matrix, right)
        if both[1] >= 0.0 and both[0] >= -1.0:
            return both
        if both[1] >= 0.0:
            return np.array([-1.0, max((right[1] + matrix[0, 1]) / diagonal[1], 0.0)])
    return np.array([max(right[0] / diagonal[0], -1.0), 0.0])


def _ring(centre: np.ndarray, angle: float) -> list[np.ndarray]:
    """Unit vectors (3,) at an angle around another."""
    first = np.cross(centre, (0.0, 0.0, 1.0) if abs(centre[2]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    second = np.cross(centre, first)
    turns = np.arange(AROUND) * (2.0 * np.pi / AROUND)
    return [np.cos(angle) * centre + np.sin(angle) * (np.cos(t) * first + np.sin(t) * second) for t in turns]


def _neighbours(points: ShadingPoints) -> np.ndarray:
    """(P, 2) points of cells beside each other in the texture, but across seams."""
    grid = points.point_of_cell.reshape(points.side, points.side)
    pairs = np.concatenate(
        [
            np.stack([grid[:, :-1].ravel(), grid[:, 1:].ravel()], axis=1),
            np.stack([grid[:-1].ravel(), grid[1:].ravel()], axis=1),
        ]
    )
    pairs = pairs[(pairs >= 0).all(axis=1)]
    if not len(pairs):
        return pairs
    apart = np.linalg.norm(points.position[pairs[:, 0]] - points.position[pairs[:, 1]], axis=1)
    return pairs[apart < ADJACENT * np.median(apart)]
