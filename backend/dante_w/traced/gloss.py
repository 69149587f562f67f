"""The sheen of a rough dielectric surface under traced light: what photos show beside the diffuse colour.

Cook-Torrance with the GGX distribution, Smith's shadowing in Schlick's form and Schlick's Fresnel term (Karis, "Real
Shading in Unreal Engine 4", 2013), for one roughness and one reflectance of the whole scene.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from dante_w.jit import njit_parallel

#: GGX alpha, the square of roughness 0.7, and reflectance at normal incidence: unpolished things.
ALPHA, REFLECTANCE = 0.49, 0.024


def sheen(
    point: np.ndarray,
    light: np.ndarray,
    towards: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
) -> np.ndarray:
    """(M, 3) float32 linear colour that M observations owe to gloss.

    Args:
        point: (M,) indices of shading points. light: (M,) indices of lights.
        towards: (M, 3) unit vectors to the camera. normals: (C, 3) of the points.
        directions: (D, 3). visible: (C, D). radiance: (J, D, 3) of the lights.
    """
    out = np.zeros((len(point), 3), np.float32)
    _sheen(point, light, towards, normals, directions, visible, radiance, ALPHA, REFLECTANCE, out)
    return out


@njit_parallel
def _sheen(
    point: np.ndarray,
    light: np.ndarray,
    towards: np.ndarray,
    normals: np.ndarray,
    directions: np.ndarray,
    visible: np.ndarray,
    radiance: np.ndarray,
    alpha: float,
    reflectance: float,
    out: np.ndarray,
) -> None:
    k = 0.5 * alpha
    for m in prange(len(point)):
        c, n, v = point[m], normals[point[m]], towards[m]
        nv = max(n[0] * v[0] + n[1] * v[1] + n[2] * v[2], 0.05)
        for d in range(len(directions)):
            if visible[c, d] == 0.0:
                continue
            w = directions[d]
            nw = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
            if nw <= 0.0:
                continue
            h0, h1, h2 = v[0] + w[0], v[1] + w[1], v[2] + w[2]
            scale = 1.0 / math.sqrt(h0 * h0 + h1 * h1 + h2 * h2 + 1e-9)
            nh = (n[0] * h0 + n[1] * h1 + n[2] * h2) * scale
            vh = min((v[0] * h0 + v[1] * h1 + v[2] * h2) * scale, 1.0)
            lobe = nh * nh * (alpha * alpha - 1.0) + 1.0
            spread = alpha * alpha / (math.pi * lobe * lobe)
            fresnel = reflectance + (1.0 - reflectance) * (1.0 - vh) ** 5
            # the BRDF times n . w; its 4 (n . w)(n . v) below is partly taken by the shadowing
            value = (
                visible[c, d] * spread * fresnel * nw / ((nw * (1.0 - k) + k) * (nv * (1.0 - k) + k) * 4.0)
            )
            for channel in range(3):
                out[m, channel] += value * radiance[light[m], d, channel]
        for channel in range(3):
            out[m, channel] *= 4.0 * math.pi / len(directions)
