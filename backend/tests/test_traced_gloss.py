"""Specular reflection against a plain reading of its formula."""

from __future__ import annotations

import numpy as np
from dante_w.traced.light_transport import LightTransport, sphere
from dante_w.traced.specular import USUAL_SPECULAR, specular_radiance

DIRECTIONS = 64
ALPHA, REFLECTANCE = USUAL_SPECULAR.alpha, USUAL_SPECULAR.reflectance


def plainly(n, v, directions, visible, radiance):
    """Cook-Torrance for one observation, direction by direction; each stands for 4 pi / D of the sphere."""
    k, total = ALPHA / 2.0, np.zeros(3)
    nv = max(n @ v, 0.05)
    for w, share, light in zip(directions, visible, radiance, strict=True):
        nw = n @ w
        if nw <= 0.0:
            continue
        h = (v + w) / np.linalg.norm(v + w)
        ggx = ALPHA**2 / (np.pi * ((n @ h) ** 2 * (ALPHA**2 - 1.0) + 1.0) ** 2)
        fresnel = REFLECTANCE + (1.0 - REFLECTANCE) * (1.0 - v @ h) ** 5
        shadowing = nw / (nw * (1.0 - k) + k) * nv / (nv * (1.0 - k) + k)
        brdf = ggx * fresnel * shadowing / (4.0 * nw * nv)
        total += share * brdf * nw * light
    return total * 4.0 * np.pi / len(directions)


def unit(random, count):
    drawn = random.normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def specular(point, light, towards, normals, directions, visible, radiance):
    transport = LightTransport(directions, visible, visible, *(np.zeros(0, int) for _ in range(4)))
    return specular_radiance(point, light, towards, normals, transport, radiance)


def geometry(rows=40, points=10, lights=3):
    random = np.random.default_rng(1)
    normals = unit(random, points)
    point, light = random.integers(0, points, rows), random.integers(0, lights, rows)
    towards = unit(random, rows)
    towards *= np.where((towards * normals[point]).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    visible = random.integers(0, 9, (points, DIRECTIONS)) / 8.0
    radiance = random.uniform(0.1, 3.0, (lights, DIRECTIONS, 3))
    arrays = (towards, normals, sphere(DIRECTIONS), visible, radiance)
    return point, light, *(array.astype(np.float32) for array in arrays)


def test_specular_radiance_is_its_formula():
    point, light, towards, normals, directions, visible, radiance = geometry()
    found = specular(point, light, towards, normals, directions, visible, radiance)
    assert found.shape == (len(point), 3) and found.dtype == np.float32
    wanted = [
        plainly(normals[p], v, directions, visible[p], radiance[j])
        for p, j, v in zip(point, light, towards.astype(np.float64), strict=True)
    ]
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


def test_nothing_visible_nothing_shines():
    point, light, towards, normals, directions, visible, radiance = geometry()
    assert (specular(point, light, towards, normals, directions, 0.0 * visible, radiance) == 0.0).all()
    below = ((normals @ directions.T) < 0.0).astype(np.float32)
    assert (specular(point, light, towards, normals, directions, below, radiance) == 0.0).all()


def test_uniform_light_returns_a_small_part():
    point, light, towards, normals, directions, visible, radiance = geometry(rows=300)
    found = specular(
        point, light, towards, normals, directions, np.ones_like(visible), np.ones_like(radiance)
    )
    assert (found < 1.0).all() and (found > REFLECTANCE / 3.0).all()
    steep = (towards * normals[point]).sum(axis=1)
    assert found[steep < 0.3].mean() > 1.5 * found[steep > 0.8].mean(), "rough things shine at grazing angles"
