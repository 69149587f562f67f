"""Specular reflection of a rough dielectric surface under traced light: what photos show beside the diffuse colour.

Cook-Torrance with the GGX distribution, Smith's shadowing in Schlick's form and Schlick's Fresnel term (Karis, "Real
Shading in Unreal Engine 4", 2013), for one roughness and one reflectance of the whole scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from dante_w.core.jit import njit_parallel_fast
from dante_w.traced.light_transport import LightTransport


@dataclass(frozen=True)
class SpecularSettings:
    """The one material whose reflections are modelled.

    Attributes:
        alpha: GGX alpha, the square of roughness 0.7: unpolished things.
        reflectance: at normal incidence (F0).
    """

    alpha: float = 0.49
    reflectance: float = 0.024


USUAL_SPECULAR = SpecularSettings()


def specular_radiance(
    point: np.ndarray,
    cluster: np.ndarray,
    towards: np.ndarray,
    normals: np.ndarray,
    transport: LightTransport,
    radiance: np.ndarray,
    settings: SpecularSettings = USUAL_SPECULAR,
) -> np.ndarray:
    """(M, 3) float32 linear colour that M observations owe to specular reflection, at an exposure of 1.

    Args:
        point: (M,) indices of shading points. cluster: (M,) indices of lights.
        towards: (M, 3) unit vectors to the camera. normals: (C, 3) unit normals of the points.
        radiance: (J, D, 3) of the lights.
    """
    out = np.empty((len(point), 3), np.float32)
    _specular_radiance(
        point,
        cluster,
        np.asarray(towards, np.float32),
        np.asarray(normals, np.float32),
        np.ascontiguousarray(transport.directions.T, np.float32),
        transport.visible,
        np.ascontiguousarray(np.moveaxis(radiance, 2, 1), np.float32),
        np.float32(settings.alpha),
        np.float32(settings.reflectance),
        np.float32(1.0 / transport.parts),
        out,
    )
    return out


@njit_parallel_fast
def _specular_radiance(
    point: np.ndarray,
    light: np.ndarray,
    towards: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
    alpha: float,
    reflectance: float,
    part: float,
    out: np.ndarray,
) -> None:
    """As `specular_radiance`, with directions (3, D), each one `part` of the sphere, and radiance (J, 3, D): the inner loop is SIMD
    in float32, so it has no branch."""
    zero, one = np.float32(0.0), np.float32(1.0)
    k = np.float32(0.5) * alpha
    sharp = alpha * alpha
    count = directions.shape[1]
    for m in prange(len(point)):
        c, n, v = point[m], normals[point[m]], towards[m]
        emitted, seen = radiance[light[m]], visible[c]
        n0, n1, n2, v0, v1, v2 = n[0], n[1], n[2], v[0], v[1], v[2]
        nv = max(n0 * v0 + n1 * v1 + n2 * v2, np.float32(0.05))
        red, green, blue = zero, zero, zero
        for d in range(count):
            w0, w1, w2 = directions[0, d], directions[1, d], directions[2, d]
            nw = n0 * w0 + n1 * w1 + n2 * w2
            nw = nw if nw > zero else zero
            h0, h1, h2 = v0 + w0, v1 + w1, v2 + w2
            scale = one / np.sqrt(h0 * h0 + h1 * h1 + h2 * h2 + np.float32(1e-9))
            nh = (n0 * h0 + n1 * h1 + n2 * h2) * scale
            vh = (v0 * h0 + v1 * h1 + v2 * h2) * scale
            vh = vh if vh < one else one
            lobe = nh * nh * (sharp - one) + one
            away = one - vh
            fresnel = reflectance + (one - reflectance) * (away * away * away * away * away)
            # the BRDF times n . w; its 4 (n . w)(n . v) below is partly taken by the shadowing
            value = seen[d] * fresnel * nw / ((nw * (one - k) + k) * lobe * lobe)
            red += value * emitted[0, d]
            green += value * emitted[1, d]
            blue += value * emitted[2, d]
        share = part * sharp / (nv * (one - k) + k)
        out[m, 0], out[m, 1], out[m, 2] = red * share, green * share, blue * share
