"""Open points whose lights, exposures and albedo are known, what photos show of them, and lights solved from that."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from dante_w.traced.light_transport import LightTransport, sphere
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import USUAL_SHADING, ShadingPoints
from dante_w.traced.solver.evidence import Evidence, gather_evidence
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.solver.solve_lights import solve_lights
from dante_w.traced.specular import specular_radiance
from dante_w.traced.state import Lighting

DIRECTIONS, POINTS, PHOTOS, LIGHTS = 64, 1500, 18, 3
SIDE = USUAL_SHADING.side
SETTINGS = SolverSettings()
#: Where nothing tells the scale of albedo, the method takes this quantile of the points' largest channel for `TOP`.
TOP, BRIGHTEST = 0.5, 0.98


@dataclasses.dataclass(frozen=True)
class World:
    points: ShadingPoints
    transport: LightTransport
    observations: Observations
    cameras: np.ndarray
    cluster: np.ndarray
    albedo: np.ndarray
    exposure: np.ndarray


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def make_world(
    lights: int = LIGHTS,
    exposures: float = 0.35,
    matte: bool = False,
    top: float = TOP,
    materials: int = POINTS,
    bounced: float = 0.0,
) -> World:
    """Open points of all orientations under up to three smooth lights; nothing hides anything else. Log exposures have a
    standard deviation of `exposures`, the brightest albedo is `top`; `matte` points have no specular reflection; points are of
    as many `materials`, in slabs, or each of its own. Each point is also lit by three others, as if these filled the share
    `bounced` of what it faces."""
    cluster = np.arange(PHOTOS) % lights
    random = np.random.default_rng(6)
    normals = unit(random.normal(size=(POINTS, 3))).astype(np.float32)
    position = random.uniform(0.3, 0.7, (POINTS, 3)).astype(np.float32)
    directions = sphere(DIRECTIONS).astype(np.float32)
    cosine = normals @ directions.T
    visible = (cosine > 0.0).astype(np.float32)
    direct = (4.0 / DIRECTIONS * np.maximum(cosine, 0.0)).astype(np.float32)
    sources = np.random.default_rng(7).integers(0, POINTS, (POINTS, 3 if bounced else 0))
    transport = LightTransport(
        directions,
        visible,
        direct,
        np.arange(POINTS + 1) * sources.shape[1],
        sources.ravel(),
        np.full(sources.size, bounced / 3.0, np.float32),
        np.zeros(POINTS, np.float32),
    )
    axes = unit(np.array([(1.0, 0.2, 0.5), (-0.6, 0.8, 0.4), (-0.3, -0.9, 0.6)]))
    hue = np.array([(0.08, 0.0, -0.08), (-0.06, 0.0, 0.06), (0.0, 0.0, 0.0)])
    bright = 1.1 * directions @ axes.T + 0.5 * (directions @ axes.T) ** 2
    radiance = np.exp(bright.T[:, :, None] + hue[:, None, :]).astype(np.float32)
    albedo = random.uniform(0.1, 0.8, (POINTS, 3))
    if materials < POINTS:
        albedo = albedo[((position[:, 0] - 0.3) / 0.4 * materials).astype(int)]
    albedo *= top / np.quantile(albedo.max(axis=1), BRIGHTEST)
    exposure = random.normal(0.0, exposures, PHOTOS)
    cameras = 0.5 + 2.0 * sphere(PHOTOS)

    photo, point = np.nonzero(np.einsum("kd,cd->kc", unit(cameras - 0.5), normals) > 0.05)
    towards = unit(cameras[photo] - position[point]).astype(np.float32)
    light = cluster[photo]
    irradiance = sky = np.tensordot(direct, radiance, axes=(1, 1))
    for _ in range(30 if bounced else 0):  # until light has bounced away
        irradiance = sky + bounced * (albedo[:, None] * irradiance)[sources].mean(axis=1)
    diffuse = albedo[point] * irradiance[point, light]
    specular = specular_radiance(point, light, towards, normals, transport, radiance)
    colour = np.exp(exposure)[photo, None] * (diffuse + (0.0 if matte else specular))
    colour *= np.exp(random.normal(0.0, 0.03, colour.shape))
    count = len(photo)
    observations = Observations(
        point.astype(np.int32),
        photo.astype(np.int32),
        colour.astype(np.float32),
        np.full(count, 4, np.int32),
        np.zeros(count, bool),
    )
    point_of_cell = np.full(SIDE * SIDE, -1, np.int32)
    point_of_cell[np.sort(random.permutation(SIDE * SIDE)[:POINTS])] = np.arange(POINTS)
    points = ShadingPoints(point_of_cell, position, normals)
    return World(points, transport, observations, cameras, cluster, albedo, exposure)


def evidence_of(world: World, settings: SolverSettings = SETTINGS, **known: Any) -> Evidence:
    """Of all that the photos show; `known`: components and what else `gather_evidence` takes."""
    return gather_evidence(world.points, world.observations, world.cameras, settings.evidence, **known)


def solve(
    world: World,
    start: np.ndarray | Lighting,
    settings: SolverSettings = SETTINGS,
    seed: int = 0,
    fine: bool = True,
    **known: Any,
) -> Lighting:
    """Lights from these clusters or coarse lights; arguments as of `solve_lights` and `evidence_of`."""
    steps: list[tuple[int, int]] = []
    evidence = evidence_of(world, settings, **known)
    lighting = solve_lights(
        evidence, world.transport, start, settings, seed, lambda *step: steps.append(step), fine
    )
    if not lighting.setbacks:
        assert [step for step, _ in steps] == list(range(1, steps[-1][1] + 1))
    return lighting


def albedo_error(world: World, lighting: Lighting) -> float:
    """Rms of log albedo at known points, after one gain per channel."""
    error = np.log(lighting.albedo[lighting.known]) - np.log(world.albedo[lighting.known])
    return float(np.sqrt(np.square(error - error.mean(axis=0)).mean()))
