"""Transfer: how much light from each direction reaches each shading point, straight or after one bounce.

The sphere is cut into D parts around evenly spread directions w_d, with light of radiance L_d from each. A photo of
a surface with albedo a sees a * sum_d T_d L_d, T_d = (4 / D) V_d max(n . w_d, 0) as a mean over rays: under light of 1
from everywhere an open point has T . L = 1. Where a ray meets the mesh instead, what leaves the mesh there arrives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import prange

from dante_w.jit import njit_parallel
from dante_w.rays.raycast import Raycaster
from dante_w.traced.shading_points import ShadingPoints

#: Rays start this far above the surface, in sides of the unit cube.
LIFT = 2e-4
#: Directions this far below a point's horizon (cosine) are traced too: faces beside it are turned a little.
BELOW = -0.3
#: Rays traced for each direction of light: light may be coarse, the shadows' edges may not.
RAYS_PER_DIRECTION = 9
#: One in this many of those rays brings bounced light, which is soft and costs memory.
BOUNCED_ONE_IN = 3
#: Rays cast at once.
RAYS = 1 << 19


@dataclass(frozen=True)
class Transfer:
    """directions (D, 3); visible (C, D) float32: the share of a direction's rays that meet nothing of the mesh; direct
    (C, D) float32, the rows T.

    Bounced light in compressed rows: point c gets sum of `weight[i]` times what leaves point `source[i]`, for i from
    `first[c]` to `first[c + 1]`; `lost` (C,) is the weight of rays that meet parts of the mesh that no photo sees.
    """

    directions: np.ndarray
    visible: np.ndarray
    direct: np.ndarray
    first: np.ndarray
    source: np.ndarray
    weight: np.ndarray
    lost: np.ndarray


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, each for an equal part of the sphere (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def trace_transfer(
    points: ShadingPoints,
    caster: Raycaster,
    uvs: np.ndarray,
    count: int,
    progress: Callable[[float], None],
) -> Transfer:
    """Trace `count` directions from every point.

    Args:
        uvs: (F, 3, 2) texture coordinates of the mesh's corners.
    """
    directions = sphere(count).astype(np.float32)
    rays = sphere(count * RAYS_PER_DIRECTION).astype(np.float32)
    part_of = (rays @ directions.T).argmax(axis=1)
    share = np.float32(4.0 / len(rays))
    visible = np.zeros((len(points), count), np.float32)
    direct = np.zeros((len(points), count), np.float32)
    lost = np.zeros(len(points), np.float32)
    rows, sources, weights = [], [], []
    membership = np.zeros((len(rays), count), np.float32)
    membership[np.arange(len(rays)), part_of] = 1.0
    step = max(RAYS // len(rays), 1)
    for start in range(0, len(points), step):
        part = slice(start, min(start + step, len(points)))
        cosine = points.normal[part] @ rays.T
        row, ray = np.nonzero(cosine > BELOW)
        point = row + start
        hits = caster.cast_from(points.position[point] + LIFT * points.normal[point], rays[ray])
        free = np.zeros(cosine.shape, np.float32)
        free[row, ray] = 1.0
        free[row[hits.ray], ray[hits.ray]] = 0.0
        visible[part] = free @ membership
        direct[part] = (share * np.maximum(cosine, 0.0) * free) @ membership

        few = ray[hits.ray] % BOUNCED_ONE_IN == BOUNCED_ONE_IN // 2
        at = hits.ray[few]
        amount = BOUNCED_ONE_IN * share * np.maximum(cosine[row[at], ray[at]], 0.0)
        bary = hits.bary[few]
        corner = np.column_stack([1.0 - bary.sum(axis=1), bary])[:, None, :]
        source = points.at((corner @ uvs[hits.face[few]])[:, 0])
        front = np.einsum("ij,ij->i", points.normal[source], rays[ray[at]]) < 0.0
        known = (source >= 0) & front & (amount > 0.0)
        lost += np.bincount(point[at], np.where(known, 0.0, amount), len(points)).astype(np.float32)
        rows.append(point[at][known])
        sources.append(source[known])
        weights.append(amount[known])
        progress(part.stop / len(points))
    row = np.concatenate(rows)
    first = np.searchsorted(row, np.arange(len(points) + 1)).astype(np.int64)
    visible /= np.maximum(membership.sum(axis=0), 1.0)
    return Transfer(
        directions, visible, direct, first, np.concatenate(sources), np.concatenate(weights), lost
    )


def coarser(transfer: Transfer, count: int) -> tuple[Transfer, np.ndarray]:
    """The same transfer for `count` directions, and which of these (D,) each of the old ones belongs to."""
    directions = sphere(count).astype(np.float32)
    part_of = (transfer.directions @ directions.T).argmax(axis=1)
    membership = np.zeros((len(part_of), count), np.float32)
    membership[np.arange(len(part_of)), part_of] = 1.0
    visible = transfer.visible @ (membership / np.maximum(membership.sum(axis=0), 1.0))
    coarse = replace(transfer, directions=directions, visible=visible, direct=transfer.direct @ membership)
    return coarse, part_of


def bounced(transfer: Transfer, leaving: np.ndarray) -> np.ndarray:
    """(C, N) float32 light that arrives from the mesh when `leaving` (C, N) leaves it."""
    arriving = np.zeros_like(leaving)
    _bounced(transfer.first, transfer.source, transfer.weight, leaving, arriving)
    return arriving + transfer.lost[:, None] * leaving.mean(axis=0)


@njit_parallel
def _bounced(
    first: np.ndarray, source: np.ndarray, weight: np.ndarray, leaving: np.ndarray, arriving: np.ndarray
) -> None:
    for c in prange(len(first) - 1):
        for i in range(first[c], first[c + 1]):
            for n in range(leaving.shape[1]):
                arriving[c, n] += weight[i] * leaving[source[i], n]
