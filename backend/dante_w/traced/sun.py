"""The sun as a light of its own: one direction, far smaller than those that the sphere is cut into.

A light gets a sun if its photos are explained better with it. For a sun in each of several directions near the light's peak,
and for the part of the sphere in its place, whose shadows are blurred, we compute how far the objective falls at best if the
brightness of the peak and that of the sun may change: a quadratic in two unknowns per channel, with log albedo
eliminated and the smoothness prior on neighbouring points, as in `solver.normal_equations`. The edges of shadows tell the
direction; a surface without cast shadows needs no sun.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dante_w.core.arrays import sums
from dante_w.rays.raycast import Raycaster
from dante_w.traced.light_transport import LightTransport, sun_visibility, with_suns
from dante_w.traced.shading_points import ShadingPoints
from dante_w.traced.solver.evidence import Evidence, observed_specular
from dante_w.traced.solver.levenberg_marquardt import minimise
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.solver.smoothness_prior import SmoothnessSettings, same_material
from dante_w.traced.solver.variable_projection import Projection, project_albedo
from dante_w.traced.state import FAINTEST, Lighting


@dataclass(frozen=True)
class SunSettings:
    """Where suns are looked for, and when one is kept."""

    #: How much brighter than the mean over the sphere the brightest of `peak_directions` is, if there may be a sun.
    peak: float = 16.0
    #: Directions of the sphere for which `peak` holds; with fewer directions a sun is blurred, and the bound lower.
    peak_directions: int = 256
    #: Angles (radians) of the rings of directions that are tried, each around the best so far.
    rings: tuple[float, ...] = (0.15, 0.08, 0.04, 0.02)
    #: Directions on a ring.
    ring_directions: int = 8
    #: Directions within this cosine of the brightest give light to the sun.
    near: float = 0.9
    #: These keep at least this share of their radiance.
    dimmest: float = 0.05
    #: A sun is kept if it lowers the objective by more of the light's part of it than the blurred direction does.
    pays: float = 0.015
    #: Radiance of a sun in the lights that have it not: above 0, since lights are solved for in logarithms.
    absent: float = 1e-9
    #: Steps of the solver once suns are added.
    steps: int = 3
    #: Weight of a pair of neighbouring cells of the texture beside a photo's observation.
    smoothness: float = 3.0
    #: Farthest neighbours of this many median distances: across the seams of the texture cells are no neighbours.
    adjacent: float = 3.0


USUAL_SUN = SunSettings()


@dataclass(frozen=True)
class Sun:
    """A sun of one light.

    Attributes:
        light: index of the light.
        direction: (3,) unit vector to the sun.
        radiance: (3,) > 0, in the unit of a direction of the sphere.
        near: (D,) bool, the directions that give light to it.
        dimming: (3,) what the radiance of these is multiplied with.
    """

    light: int
    direction: np.ndarray
    radiance: np.ndarray
    near: np.ndarray
    dimming: np.ndarray


def find_and_add_suns(
    evidence: Evidence,
    transport: LightTransport,
    lighting: Lighting,
    caster: Raycaster,
    seed: int,
    solver: SolverSettings,
    settings: SunSettings,
) -> tuple[LightTransport, Lighting]:
    """The light transport and the lights with suns, and refined if there are any."""
    specular = (
        observed_specular(evidence, transport, lighting, solver.specular)
        if evidence.components.specular
        else np.zeros_like(evidence.weight)
    )
    irradiance = lighting.irradiance(transport)
    _, projection = project_albedo(lighting, irradiance, specular, evidence, solver.projection)
    suns = []
    for light in np.flatnonzero(peaks(lighting) >= least_peak(transport.parts, settings)):
        problem = _problem(evidence, transport, lighting, projection, int(light), solver.smoothness, settings)
        sun = _search(problem, evidence.points, transport, caster, settings)
        if sun is not None:
            suns.append(sun)
    if not suns:
        return transport, lighting
    transport, lighting = _with_suns(suns, evidence.points, transport, lighting, caster, settings)
    steps = range(solver.steps, solver.steps + settings.steps)
    return transport, minimise(lighting, transport, evidence, solver, steps, seed, lambda _: None)


def peaks(lighting: Lighting) -> np.ndarray:
    """(J,) how much brighter than the mean the brightest direction of each light is."""
    brightness = lighting.radiance.mean(axis=2)
    return np.asarray(brightness.max(axis=1) / brightness.mean(axis=1))


def least_peak(directions: int, settings: SunSettings) -> float:
    """The peak from which on a light of so many directions may have a sun."""
    return settings.peak * directions / settings.peak_directions


def _with_suns(
    suns: list[Sun],
    points: ShadingPoints,
    transport: LightTransport,
    lighting: Lighting,
    caster: Raycaster,
    settings: SunSettings,
) -> tuple[LightTransport, Lighting]:
    wider = with_suns(transport, points, caster, np.stack([sun.direction for sun in suns]))
    shape = (len(lighting.radiance), len(suns), 3)
    absent = np.full(shape, settings.absent, np.float32)
    radiance = np.concatenate([lighting.radiance, absent], axis=1)
    for number, sun in enumerate(suns):
        radiance[sun.light, : -len(suns)][sun.near] *= sun.dimming
        radiance[sun.light, transport.parts + number] = sun.radiance
    return wider, replace(lighting, radiance=radiance.astype(np.float32))


@dataclass(frozen=True)
class _Problem:
    """One light's equations in the log brightness of its peak and in a sun.

    Attributes:
        light: index of the light. irradiance: (C, 3) of the points under it.
        weight: (C, 3) of the light's observations. share: (C, 3) of these in the weight of all observations.
        gradient: (C, 3) sum of weight times residual of the light's observations.
        peak: (C, 3) share of the irradiance that comes from `near` the brightest `direction`; near: (D,) bool.
        pairs: (P, 2) neighbouring points, with pair_weight (P,) and pair_step (P, 3), the difference of log albedo.
        cost: the sum of squares at present. unit: irradiance that radiance 1 from a faced direction adds.
    """

    light: int
    irradiance: np.ndarray
    weight: np.ndarray
    share: np.ndarray
    gradient: np.ndarray
    peak: np.ndarray
    direction: np.ndarray
    near: np.ndarray
    pairs: np.ndarray
    pair_weight: np.ndarray
    pair_step: np.ndarray
    cost: float
    unit: float


def _problem(
    evidence: Evidence,
    transport: LightTransport,
    lighting: Lighting,
    projection: Projection,
    light: int,
    smoothness: SmoothnessSettings,
    settings: SunSettings,
) -> _Problem:
    points, observations, count = evidence.points, evidence.observations, len(evidence.points)
    known = lighting.known[:, None]
    rows = lighting.cluster[observations.photo] == light
    point, row_weight = observations.point[rows], projection.weight[rows]
    weighted = row_weight * projection.residual[rows]
    irradiance = lighting.irradiance(transport)[:, light]
    weight = sums(row_weight, point, count) * known
    share = weight / (sums(projection.weight, observations.point, count) + 1e-9)
    brightest = transport.directions[lighting.radiance[light].mean(axis=1).argmax()]
    near = transport.directions @ brightest > settings.near
    peak = np.einsum("cd,dx->cx", transport.direct[:, near], lighting.radiance[light][near]) / irradiance
    pairs = _neighbours(points, settings.adjacent)
    pairs = pairs[lighting.known[pairs].all(axis=1)]
    log_albedo = np.log(np.maximum(lighting.albedo, FAINTEST))
    pair_step = log_albedo[pairs[:, 0]] - log_albedo[pairs[:, 1]]
    pair_weight = settings.smoothness * same_material(pair_step, smoothness)
    rough = np.square(share[pairs].mean(axis=1) * pair_step).sum(axis=1)
    others = 1.0 - share[point]
    cost = float((others * weighted * projection.residual[rows]).sum() + pair_weight @ rough)
    return _Problem(
        light,
        irradiance,
        weight,
        share,
        sums(weighted, point, count) * known,
        peak,
        brightest,
        near,
        pairs,
        pair_weight,
        pair_step,
        cost,
        transport.share,
    )


def _search(
    problem: _Problem,
    points: ShadingPoints,
    transport: LightTransport,
    caster: Raycaster,
    settings: SunSettings,
) -> Sun | None:
    """The best sun near the light's peak, if it pays."""
    best, centre, change = -np.inf, problem.direction.astype(np.float64), np.zeros((3, 2))
    for number, angle in enumerate(settings.rings):
        ring = _ring(centre, angle, settings.ring_directions)
        for direction in ring if number else [centre, *ring]:
            facing = np.maximum(points.normal @ direction, 0.0)
            column = (facing * sun_visibility(points.position, points.normal, caster, direction))[:, None]
            fall, answer = _fall(problem, column)
            if fall > best:
                best, centre, change = fall, direction, answer
    blurred = transport.direct[:, [(transport.directions @ centre).argmax()]] / transport.share
    if best - _fall(problem, blurred)[0] <= settings.pays * problem.cost or not (change[:, 1] > 0.0).all():
        return None
    dimming = np.maximum(1.0 + change[:, 0], settings.dimmest)
    return Sun(problem.light, centre, change[:, 1] / problem.unit, problem.near, dimming)


def _fall(problem: _Problem, column: np.ndarray) -> tuple[float, np.ndarray]:
    """How far the sum of squares falls at best, and the changes (3, 2) of the peak (relative) and of a sun that do it.

    Args:
        column: (C, 1) irradiance of the points under a sun of 1.
    """
    total, changes = 0.0, np.zeros((3, 2))
    first, second = problem.pairs.T
    for channel in range(3):
        jacobian = np.column_stack(
            [problem.peak[:, channel], column[:, 0] / problem.irradiance[:, channel]]
        ).astype(float)
        moved = jacobian * problem.share[:, channel, None]
        rough = moved[first] - moved[second]
        weight = problem.weight[:, channel] * (1.0 - problem.share[:, channel])
        matrix = (jacobian * weight[:, None]).T @ jacobian + (rough * problem.pair_weight[:, None]).T @ rough
        right = jacobian.T @ problem.gradient[:, channel] + rough.T @ (
            problem.pair_weight * problem.pair_step[:, channel]
        )
        changes[channel] = _bounded(matrix, right)
        total += float(2.0 * right @ changes[channel] - changes[channel] @ matrix @ changes[channel])
    return total, changes


def _bounded(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The (peak, sun) that minimises a quadratic where a peak loses no more than all of it, and no sun is negative."""
    diagonal = np.maximum(matrix.diagonal(), 1e-9)
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] ** 2
    if determinant > 1e-6 * diagonal[0] * diagonal[1]:
        both = np.linalg.solve(matrix, right)
        if both[1] >= 0.0 and both[0] >= -1.0:
            return both
        if both[1] >= 0.0:
            return np.array([-1.0, max((right[1] + matrix[0, 1]) / diagonal[1], 0.0)])
    return np.array([max(right[0] / diagonal[0], -1.0), 0.0])


def _ring(centre: np.ndarray, angle: float, count: int) -> list[np.ndarray]:
    """Unit vectors (3,) at an angle around another."""
    first = np.cross(centre, (0.0, 0.0, 1.0) if abs(centre[2]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    second = np.cross(centre, first)
    turns = np.arange(count) * (2.0 * np.pi / count)
    return [np.cos(angle) * centre + np.sin(angle) * (np.cos(t) * first + np.sin(t) * second) for t in turns]


def _neighbours(points: ShadingPoints, adjacent: float) -> np.ndarray:
    """(P, 2) points of cells beside each other in the texture, at most `adjacent` median distances apart."""
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
    distance = np.linalg.norm(points.position[pairs[:, 0]] - points.position[pairs[:, 1]], axis=1)
    return pairs[distance < adjacent * np.median(distance)]
