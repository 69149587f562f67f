"""Open points whose lights, exposures and albedo are known, and what photos show of them."""

from __future__ import annotations

import dataclasses

import numpy as np
from dante_w.traced.light_transport import LightTransport, sphere
from dante_w.traced.observations import Observations
from dante_w.traced.shading_points import USUAL_SHADING, ShadingPoints
from dante_w.traced.solver.solve_lights import BRIGHTEST, TOP
from dante_w.traced.specular import specular_radiance

DIRECTIONS, POINTS, PHOTOS, LIGHTS = 64, 1500, 18, 3
SIDE = USUAL_SHADING.side


@dataclasses.dataclass(frozen=True)
class World:
    points: ShadingPoints
    transfer: LightTransport
    seen: Observations
    cameras: np.ndarray
    light: np.ndarray
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
) -> World:
    """Open points of all orientations under up to three smooth lights; nothing hides or lights anything else. Log
    exposures have a standard deviation of `exposures`, the brightest albedo is `top`; `matte` points have no sheen; points are
    of as many `materials`, in slabs, or each of its own."""
    of_photo = np.arange(PHOTOS) % lights
    random = np.random.default_rng(6)
    normals = unit(random.normal(size=(POINTS, 3))).astype(np.float32)
    position = random.uniform(0.3, 0.7, (POINTS, 3)).astype(np.float32)
    directions = sphere(DIRECTIONS).astype(np.float32)
    cosine = normals @ directions.T
    visible = (cosine > 0.0).astype(np.float32)
    direct = (4.0 / DIRECTIONS * np.maximum(cosine, 0.0)).astype(np.float32)
    transfer = LightTransport(
        directions,
        visible,
        direct,
        np.zeros(POINTS + 1, np.int64),
        np.zeros(0, np.int64),
        np.zeros(0, np.float32),
        np.zeros(POINTS, np.float32),
    )
    axes = unit(np.array([(1.0, 0.2, 0.5), (-0.6, 0.8, 0.4), (-0.3, -0.9, 0.6)]))
    tint = np.array([(0.08, 0.0, -0.08), (-0.06, 0.0, 0.06), (0.0, 0.0, 0.0)])
    bright = 1.1 * directions @ axes.T + 0.5 * (directions @ axes.T) ** 2
    radiance = np.exp(bright.T[:, :, None] + tint[:, None, :]).astype(np.float32)
    albedo = random.uniform(0.1, 0.8, (POINTS, 3))
    if materials < POINTS:
        albedo = albedo[((position[:, 0] - 0.3) / 0.4 * materials).astype(int)]
    albedo *= top / np.quantile(albedo.max(axis=1), BRIGHTEST)
    exposure = random.normal(0.0, exposures, PHOTOS)
    cameras = 0.5 + 2.0 * sphere(PHOTOS)

    photo, point = np.nonzero(np.einsum("kd,cd->kc", unit(cameras - 0.5), normals) > 0.05)
    towards = unit(cameras[photo] - position[point]).astype(np.float32)
    light = of_photo[photo]
    diffuse = albedo[point] * np.tensordot(direct, radiance, axes=(1, 1))[point, light]
    gloss = specular_radiance(point, light, towards, normals, transfer, radiance)
    colour = np.exp(exposure)[photo, None] * (diffuse + (0.0 if matte else gloss))
    colour *= np.exp(random.normal(0.0, 0.03, colour.shape))
    count = len(photo)
    seen = Observations(
        point.astype(np.int32),
        photo.astype(np.int32),
        colour.astype(np.float32),
        np.full(count, 4, np.int32),
        np.zeros(count, bool),
    )
    point_of_cell = np.full(SIDE * SIDE, -1, np.int32)
    point_of_cell[np.sort(random.permutation(SIDE * SIDE)[:POINTS])] = np.arange(POINTS)
    points = ShadingPoints(point_of_cell, position, normals)
    return World(points, transfer, seen, cameras, of_photo, albedo, exposure)
