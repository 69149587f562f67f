"""Transfer: how much light from each direction reaches each shading point, straight or after one bounce.

The sphere is cut into D parts around evenly spread directions w_d, with light of radiance L_d from each. A photo of
a surface with albedo a sees a * sum_d T_d L_d, T_d = (4 / D) V_d max(n . w_d, 0) as a mean over rays: under light of 1
from everywhere an open point has T . L = 1. Where a ray meets the mesh instead, what leaves the mesh there arrives.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numba import prange

from dante_w.core.jit import njit_fast, njit_parallel
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
#: Angular radius at which a sun's disc is looked at: the real one's is 0.0047.
SUN_RADIUS = 0.004
#: Rays cast at once, by one thread.
RAYS = 1 << 17


@dataclass(frozen=True)
class LightTransport:
    """directions (D, 3); visible (C, D) float32: the share of a direction's rays that meet nothing of the mesh; direct
    (C, D) float32, the rows T. The last `suns` directions are no parts of the sphere but suns, see `with_suns`.

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
    suns: int = 0

    @property
    def parts(self) -> int:
        """Parts of the sphere; directions from this on are suns."""
        return len(self.directions) - self.suns

    @property
    def share(self) -> float:
        """What light of 1 from a direction that a surface faces adds to its irradiance."""
        return 4.0 / self.parts


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, each for an equal part of the sphere (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def trace_light_transport(
    points: ShadingPoints,
    caster: Raycaster,
    uvs: np.ndarray,
    count: int,
    progress: Callable[[float], None],
) -> LightTransport:
    """Trace `count` directions from every point.

    Args:
        uvs: (F, 3, 2) texture coordinates of the mesh's corners.
    """
    directions = sphere(count).astype(np.float32)
    rays = sphere(count * RAYS_PER_DIRECTION).astype(np.float32)
    part_of = (rays @ directions.T).argmax(axis=1)
    many = len(points)
    visible, direct = np.zeros((many, count), np.float32), np.zeros((many, count), np.float32)
    lost = np.zeros(many, np.float32)
    step = max(RAYS // len(rays), 1)

    def block(start: int) -> tuple[np.ndarray, ...]:
        part = slice(start, min(start + step, many))
        return _trace(points, part, caster, uvs, rays, part_of, visible[part], direct[part], lost[part])

    bounces = []
    with ThreadPoolExecutor(
        os.cpu_count()
    ) as threads:  # arrays are made and summed up in parallel, not only rays cast
        for done, bounce in enumerate(threads.map(block, range(0, many, step))):
            bounces.append(bounce)
            progress(min((done + 1) * step / many, 1.0))
    point, source, weight = (np.concatenate(column) for column in zip(*bounces, strict=True))
    first = np.searchsorted(point, np.arange(many + 1)).astype(np.int64)
    visible /= np.maximum(np.bincount(part_of, minlength=count), 1).astype(np.float32)
    return LightTransport(directions, visible, direct, first, source, weight, lost)


def _trace(
    points: ShadingPoints,
    part: slice,
    caster: Raycaster,
    uvs: np.ndarray,
    rays: np.ndarray,
    part_of: np.ndarray,
    visible: np.ndarray,
    direct: np.ndarray,
    lost: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace `rays` from some of the points, in one thread: adds up their rows of `visible`, `direct` and `lost`, and returns
    point, source and weight of the rays that bring bounced light, in the points' order."""
    position, normal = points.position[part], points.normal[part]
    # where bounced light comes from has to be known; of other rays, only whether they meet anything
    bears = np.arange(len(rays)) % BOUNCED_ONE_IN == BOUNCED_ONE_IN // 2
    room = len(position) * len(rays)
    origin, way = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    row, ray, facing = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.float32)
    bearers, others = _aim(position, normal, rays, bears, origin, way, row, ray, facing)
    face, second, third = caster.first(origin[:bearers], way[:bearers])
    share = np.float32(4.0 / len(rays))
    for some, hit in (
        (slice(bearers), face >= 0),
        (slice(room - others, room), caster.blocked(origin[room - others :], way[room - others :])),
    ):
        _add_up(row[some], ray[some], part_of, facing[some], hit, share, visible, direct)

    hit = np.flatnonzero(face >= 0)
    row, ray, face = row[hit], ray[hit], face[hit]
    amount = BOUNCED_ONE_IN * share * facing[hit]
    bary = np.stack([second[hit], third[hit]], axis=1)
    corner = np.column_stack([1.0 - bary.sum(axis=1), bary])[:, None, :]
    source = points.at((corner @ uvs[face])[:, 0])
    known = (source >= 0) & (np.einsum("ij,ij->i", points.normal[source], rays[ray]) < 0.0)
    lost += np.bincount(row, np.where(known, 0.0, amount), len(lost)).astype(np.float32)
    return row[known].astype(np.int64) + part.start, source[known], amount[known]


@njit_fast
def _aim(position, normal, rays, bears, origin, way, row, ray, facing):  # type: ignore[no-untyped-def]
    """Fill in the rays (N, 3) to trace from points, and what belongs to them: those that bear light from the front of the
    arrays, the others from their end. Returns how many there are of either."""
    front, back = 0, len(row)
    for i in range(len(position)):
        for d in range(len(rays)):
            cosine = normal[i, 0] * rays[d, 0] + normal[i, 1] * rays[d, 1] + normal[i, 2] * rays[d, 2]
            if cosine <= np.float32(BELOW):
                continue
            if bears[d] and cosine > np.float32(0.0):
                at = front
                front += 1
            else:
                back -= 1
                at = back
            for axis in range(3):
                origin[at, axis] = position[i, axis] + np.float32(LIFT) * normal[i, axis]
                way[at, axis] = rays[d, axis]
            row[at], ray[at], facing[at] = i, d, cosine
    return front, len(row) - back


@njit_fast
def _add_up(row, ray, part_of, facing, hit, share, visible, direct):  # type: ignore[no-untyped-def]
    for i in range(len(row)):
        if not hit[i]:
            part = part_of[ray[i]]
            visible[row[i], part] += np.float32(1.0)
            direct[row[i], part] += share * max(facing[i], np.float32(0.0))


def coarser(transfer: LightTransport, count: int) -> tuple[LightTransport, np.ndarray]:
    """The same transfer for `count` directions, and which of these (D,) each of the old ones belongs to."""
    directions = sphere(count).astype(np.float32)
    part_of = (transfer.directions @ directions.T).argmax(axis=1)
    membership = np.zeros((len(part_of), count), np.float32)
    membership[np.arange(len(part_of)), part_of] = 1.0
    visible = transfer.visible @ (membership / np.maximum(membership.sum(axis=0), 1.0))
    coarse = replace(transfer, directions=directions, visible=visible, direct=transfer.direct @ membership)
    return coarse, part_of


def with_suns(
    transfer: LightTransport, points: ShadingPoints, caster: Raycaster, suns: np.ndarray
) -> LightTransport:
    """The same transfer with more directions, in the unit of the others: suns (S, 3), as seen from the points."""
    if not len(suns):
        return transfer
    seen = np.stack([sunlit(points.position, points.normal, caster, sun) for sun in suns], axis=1)
    facing = np.maximum(points.normal @ suns.T, 0.0).astype(np.float32)
    return replace(
        transfer,
        directions=np.concatenate([transfer.directions, suns.astype(np.float32)]),
        visible=np.concatenate([transfer.visible, seen], axis=1),
        direct=np.concatenate([transfer.direct, np.float32(transfer.share) * seen * facing], axis=1),
        suns=transfer.suns + len(suns),
    )


def sunlit(position: np.ndarray, normal: np.ndarray, caster: Raycaster, sun: np.ndarray) -> np.ndarray:
    """(N,) float32: how much of a sun (3,) is seen from surface points (N, 3) with normals (N, 3)."""
    seen = np.zeros(len(position), np.float32)
    faces = np.flatnonzero(normal @ sun > 0.0)
    origin = np.asarray(position[faces] + LIFT * normal[faces], np.float32)
    across = np.cross(sun, (0.0, 0.0, 1.0) if abs(sun[2]) < 0.9 else (1.0, 0.0, 0.0))
    across *= SUN_RADIUS / np.linalg.norm(across)
    for aside in (across, -across, np.cross(sun, across), np.cross(across, sun)):
        way = np.broadcast_to(np.asarray(sun + aside, np.float32), origin.shape).copy()
        seen[faces] += np.float32(0.25) * ~caster.all_blocked(origin, way)
    return seen


def bounced(transfer: LightTransport, leaving: np.ndarray) -> np.ndarray:
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
