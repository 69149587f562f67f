"""Neighbours mostly share an albedo: what tells shading from paint where photos differ too little in light.

Under one light every photo shows the same product of albedo and irradiance; the mesh says how irradiance may vary over the
surface, and nothing says how albedo does but this: points that lie close together, and fewer that lie anywhere, are of one
material unless their colours say otherwise (Land and McCann, "Lightness and Retinex Theory", 1971; the weights are those of a
Cauchy distribution, so that an edge in albedo costs little).
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange

from dante_w.core.jit import njit_parallel

#: What evenness counts beside the observations of a point.
WEIGHT = 10.0
#: Nearest points that each is paired with, points anywhere, and what such a pair counts beside a near one.
NEAR, FAR, FAR_WEIGHT = 6, 3, 0.15
#: Difference of log albedo, in brightness and in colour, at which a pair counts half.
BRIGHTNESS, COLOUR = 0.2, 0.05


def smoothness_laplacian(
    position: np.ndarray, log_albedo: np.ndarray, generator: np.random.Generator
) -> torch.Tensor:
    """(C, C) sparse float32: x @ it @ x is the weighted sum of squared differences of x over pairs.

    Args:
        position: (C, 3) of points. log_albedo: (C, 3) as they are taken for at present.
    """
    count = len(position)
    near, far = min(NEAR, count - 1), min(FAR, count - 1)
    first = np.repeat(np.arange(count), near + far)
    anywhere = (np.arange(count)[:, None] + generator.integers(1, max(count, 2), (count, far))) % count
    second = np.concatenate([_nearest(position, near), anywhere], axis=1).reshape(-1)
    weight = np.tile(np.r_[np.ones(near), np.full(far, FAR_WEIGHT)], count) * (WEIGHT / (NEAR + FAR))
    weight *= agreement(log_albedo[first] - log_albedo[second])
    total = np.bincount(first, weight, count) + np.bincount(second, weight, count)
    everyone = np.arange(count)
    rows, columns = np.r_[first, second, everyone], np.r_[second, first, everyone]
    values = np.r_[-weight, -weight, total].astype(np.float32)
    indices = torch.from_numpy(np.stack([rows, columns]))
    pairs = torch.sparse_coo_tensor(indices, torch.from_numpy(values), (count, count), check_invariants=False)
    return pairs.coalesce()


def agreement(apart: np.ndarray) -> np.ndarray:
    """(P,) between 0 and 1: how likely pairs of points that differ by so much (P, 3) in log albedo are of one material."""
    brightness = apart.mean(axis=1)
    colour = np.square(apart - brightness[:, None]).sum(axis=1)
    return np.asarray(1.0 / (1.0 + np.square(brightness / BRIGHTNESS) + colour / COLOUR**2))


@njit_parallel
def _nearest(position: np.ndarray, count: int) -> np.ndarray:
    """(C, count) the nearest other points of each of C points (C, 3), nearest first. All are looked at: of a few thousand
    points that takes milliseconds."""
    points = len(position)
    found = np.zeros((points, count), np.int64)
    for c in prange(points):
        apart = np.full(count + 1, np.inf)  # the last place is what falls out
        own = np.zeros(count + 1, np.int64)
        x, y, z = position[c, 0], position[c, 1], position[c, 2]
        for other in range(points):
            square = (
                (position[other, 0] - x) ** 2 + (position[other, 1] - y) ** 2 + (position[other, 2] - z) ** 2
            )
            if square >= apart[count] or other == c:
                continue
            place = count
            while place > 0 and square < apart[place - 1]:
                apart[place], own[place] = apart[place - 1], own[place - 1]
                place -= 1
            apart[place], own[place] = square, other
        found[c] = own[:count]
    return found
