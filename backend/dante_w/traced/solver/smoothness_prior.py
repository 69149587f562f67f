"""The smoothness prior: neighbouring points mostly share an albedo.

This tells shading from paint where photos differ too little in light. Under one light every photo shows the same product
of albedo and irradiance. The mesh says how irradiance can vary over the surface, and only this prior says how albedo
does: points that lie close together, and some pairs that lie anywhere, are of one material unless their colours differ
(Land and McCann, "Lightness and Retinex Theory", 1971). The weight of a pair falls with its difference as in a Cauchy
distribution, so an edge in albedo costs little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numba import prange

from dante_w.core.jit import njit_parallel


@dataclass(frozen=True)
class SmoothnessSettings:
    """The prior has no length scale of its own: the spacing of the points of a step sets it
    (`SolverSettings.points_per_step`)."""

    #: Weight of the pairs that a point starts if all were near, beside its photos: one photo's observation weighs up to 4.
    #: Six near and three far pairs come to 7.2. Only where photos share one light does it decide.
    weight: float = 10.0
    #: Nearest points that each point is paired with.
    nearest: int = 6
    #: Points anywhere that each point is paired with: they carry what is alike across the whole surface.
    anywhere: int = 3
    #: Weight of a pair anywhere beside that of a near one.
    anywhere_weight: float = 0.15
    #: Difference in the brightness of albedo (natural log) at which a pair has half its weight.
    brightness: float = 0.2
    #: The same for the colour of albedo. Shading changes brightness more than colour, paint both.
    colour: float = 0.05


def smoothness_laplacian(
    position: np.ndarray, log_albedo: np.ndarray, generator: np.random.Generator, settings: SmoothnessSettings
) -> torch.Tensor:
    """(C, C) sparse float32 graph Laplacian Q: x' Q x is the weighted sum of squared differences of x over all pairs.

    Args:
        position: (C, 3) of the points, in any unit. log_albedo: (C, 3) present natural log of their linear albedo.
        generator: draws the pairs that lie anywhere.
    """
    count = len(position)
    nearest, anywhere = (min(pairs, count - 1) for pairs in (settings.nearest, settings.anywhere))
    first = np.repeat(np.arange(count), nearest + anywhere)
    offset = generator.integers(1, max(count, 2), (count, anywhere))
    drawn = (np.arange(count)[:, None] + offset) % count
    second = np.concatenate([_nearest(position, nearest), drawn], axis=1).reshape(-1)
    share = settings.weight / (settings.nearest + settings.anywhere)
    weight = np.tile(np.r_[np.ones(nearest), np.full(anywhere, settings.anywhere_weight)], count) * share
    weight *= same_material(log_albedo[first] - log_albedo[second], settings)
    total = np.bincount(first, weight, count) + np.bincount(second, weight, count)
    diagonal = np.arange(count)
    rows, columns = np.r_[first, second, diagonal], np.r_[second, first, diagonal]
    values = np.r_[-weight, -weight, total].astype(np.float32)
    indices = torch.from_numpy(np.stack([rows, columns]))
    pairs = torch.sparse_coo_tensor(indices, torch.from_numpy(values), (count, count), check_invariants=False)
    return pairs.coalesce()


def same_material(difference: np.ndarray, settings: SmoothnessSettings) -> np.ndarray:
    """(P,) in (0, 1]: how likely pairs of points with this difference of log albedo (P, 3) are of one material."""
    brightness = difference.mean(axis=1)
    colour = np.square(difference - brightness[:, None]).sum(axis=1)
    return np.asarray(1.0 / (1.0 + np.square(brightness / settings.brightness) + colour / settings.colour**2))


@njit_parallel
def _nearest(position: np.ndarray, count: int) -> np.ndarray:
    """(C, count) the nearest other points of each of C points (C, 3), nearest first. It compares every pair: for a few
    thousand points that takes milliseconds."""
    points = len(position)
    nearest = np.zeros((points, count), np.int64)
    for c in prange(points):
        distance = np.full(count + 1, np.inf)  # the last place is what falls out
        index = np.zeros(count + 1, np.int64)
        x, y, z = position[c, 0], position[c, 1], position[c, 2]
        for other in range(points):
            square = (
                (position[other, 0] - x) ** 2 + (position[other, 1] - y) ** 2 + (position[other, 2] - z) ** 2
            )
            if square >= distance[count] or other == c:
                continue
            place = count
            while place > 0 and square < distance[place - 1]:
                distance[place], index[place] = distance[place - 1], index[place - 1]
                place -= 1
            distance[place], index[place] = square, other
        nearest[c] = index[:count]
    return nearest
