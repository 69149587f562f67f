"""Light transport (precomputed radiance transfer): how much light from each direction reaches each shading point, straight or after one bounce.

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


@dataclass(frozen=True)
class TransportSettings:
    """How light is traced.

    Attributes:
        lift: rays start this far above the surface, in sides of the unit cube.
        below: directions this far below a point's horizon (cosine) are traced too: faces beside it are turned a little.
        rays_per_direction: light may be coarse, the shadows' edges may not.
        bounced_one_in: one in this many of those rays brings bounced light, which is soft and costs memory.
        sun_radius: angular radius (radians) at which a sun's disc is looked at: the real one's is 0.0047.
        rays_at_once: cast by one thread.
    """

    lift: float = 2e-4
    below: float = -0.3
    rays_per_direction: int = 9
    bounced_one_in: int = 3
    sun_radius: float = 0.004
    rays_at_once: int = 1 << 17


USUAL_TRANSPORT = TransportSettings()


@dataclass(frozen=True)
class LightTransport:
    """How light reaches C shading points from D directions.

    Attributes:
        directions: (D, 3) float32 unit vectors; the last `suns` of them are no parts of the sphere but suns, see `with_suns`.
        visible: (C, D) float32, the share of a direction's rays that meet nothing of the mesh.
        direct: (C, D) float32, the rows T of the module's docstring.
        indptr, indices, weight: bounced light in compressed sparse rows: point c gets the sum of `weight[i]` times what leaves
            point `indices[i]`, for i from `indptr[c]` to `indptr[c + 1]`.
        lost: (C,) the weight of rays that meet parts of the mesh that no photo sees.
    """

    directions: np.ndarray
    visible: np.ndarray
    direct: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
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
    settings: TransportSettings = USUAL_TRANSPORT,
) -> LightTransport:
    """Trace `count` directions from every point.

    Args:
        uvs: (F, 3, 2) texture coordinates of the mesh's corners.
    """
    directions = sphere(count).astype(np.float32)
    rays = sphere(count * settings.rays_per_direction).astype(np.float32)
    direction_of_ray = (rays @ directions.T).argmax(axis=1)
    beams = _Beams(rays, direction_of_ray, uvs, settings)
    many = len(points)
    visible, direct = np.zeros((many, count), np.float32), np.zeros((many, count), np.float32)
    lost = np.zeros(many, np.float32)
    step = max(settings.rays_at_once // len(rays), 1)

    def block(start: int) -> tuple[np.ndarray, ...]:
        part = slice(start, min(start + step, many))
        return _trace(points, part, caster, beams, visible[part], direct[part], lost[part])

    bounces = []
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # arrays are made and summed up in parallel, too
        for done, bounce in enumerate(threads.map(block, range(0, many, step))):
            bounces.append(bounce)
            progress(min((done + 1) * step / many, 1.0))
    point, source, weight = (np.concatenate(column) for column in zip(*bounces, strict=True))
    indptr = np.searchsorted(point, np.arange(many + 1)).astype(np.int64)
    visible /= np.maximum(np.bincount(direction_of_ray, minlength=count), 1).astype(np.float32)
    return LightTransport(directions, visible, direct, indptr, source, weight, lost)


@dataclass(frozen=True)
class _Beams:
    """What is the same for all points: `rays` (N, 3), the direction that each belongs to (N,), the mesh's UVs."""

    rays: np.ndarray
    direction_of_ray: np.ndarray
    uvs: np.ndarray
    settings: TransportSettings


def _trace(
    points: ShadingPoints,
    part: slice,
    caster: Raycaster,
    beams: _Beams,
    visible: np.ndarray,
    direct: np.ndarray,
    lost: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace rays from some of the points, in one thread: adds up their rows of `visible`, `direct` and `lost`, and returns
    point, source and weight of the rays that bring bounced light, in the points' order."""
    position, normal = points.position[part], points.normal[part]
    rays, one_in = beams.rays, beams.settings.bounced_one_in
    # where bounced light comes from has to be known; of other rays, only whether they meet anything
    bears = np.arange(len(rays)) % one_in == one_in // 2
    room = len(position) * len(rays)
    origin, direction = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    row, ray, cosine = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.float32)
    lift, below = np.float32(beams.settings.lift), np.float32(beams.settings.below)
    bearers, others = _aim(position, normal, rays, bears, lift, below, origin, direction, row, ray, cosine)
    face, second, third = caster.first(origin[:bearers], direction[:bearers])
    share = np.float32(4.0 / len(rays))
    for some, hit in (
        (slice(bearers), face >= 0),
        (slice(room - others, room), caster.blocked(origin[room - others :], direction[room - others :])),
    ):
        _add_up(row[some], ray[some], beams.direction_of_ray, cosine[some], hit, share, visible, direct)

    hit = np.flatnonzero(face >= 0)
    row, ray, face = row[hit], ray[hit], face[hit]
    amount = one_in * share * cosine[hit]
    bary = np.stack([second[hit], third[hit]], axis=1)
    corner = np.column_stack([1.0 - bary.sum(axis=1), bary])[:, None, :]
    source = points.at((corner @ beams.uvs[face])[:, 0])
    known = (source >= 0) & (np.einsum("ij,ij->i", points.normal[source], rays[ray]) < 0.0)
    lost += np.bincount(row, np.where(known, 0.0, amount), len(lost)).astype(np.float32)
    return row[known].astype(np.int64) + part.start, source[known], amount[known]


@njit_fast
def _aim(position, normal, rays, bears, lift, below, origin, direction, row, ray, cosines):  # type: ignore[no-untyped-def]
    """Fill in the rays (N, 3) to trace from points, and what belongs to them: those that bear light from the front of the
    arrays, the others from their end. Returns how many there are of either."""
    front, back = 0, len(row)
    for i in range(len(position)):
        for d in range(len(rays)):
            cosine = normal[i, 0] * rays[d, 0] + normal[i, 1] * rays[d, 1] + normal[i, 2] * rays[d, 2]
            if cosine <= below:
                continue
            if bears[d] and cosine > np.float32(0.0):
                slot = front
                front += 1
            else:
                back -= 1
                slot = back
            for axis in range(3):
                origin[slot, axis] = position[i, axis] + lift * normal[i, axis]
                direction[slot, axis] = rays[d, axis]
            row[slot], ray[slot], cosines[slot] = i, d, cosine
    return front, len(row) - back


@njit_fast
def _add_up(row, ray, direction_of_ray, cosine, hit, share, visible, direct):  # type: ignore[no-untyped-def]
    """Count rays that meet nothing (hit False) towards `visible`, and their share of the cosine towards `direct`."""
    for i in range(len(row)):
        if not hit[i]:
            d = direction_of_ray[ray[i]]
            visible[row[i], d] += np.float32(1.0)
            direct[row[i], d] += share * max(cosine[i], np.float32(0.0))


def coarser(transport: LightTransport, count: int) -> tuple[LightTransport, np.ndarray]:
    """The same light transport for `count` directions, and which of these (D,) each of the old ones belongs to."""
    directions = sphere(count).astype(np.float32)
    coarse_of = (transport.directions @ directions.T).argmax(axis=1)
    membership = np.zeros((len(coarse_of), count), np.float32)
    membership[np.arange(len(coarse_of)), coarse_of] = 1.0
    visible = transport.visible @ (membership / np.maximum(membership.sum(axis=0), 1.0))
    coarse = replace(transport, directions=directions, visible=visible, direct=transport.direct @ membership)
    return coarse, coarse_of


def with_suns(
    transport: LightTransport,
    points: ShadingPoints,
    caster: Raycaster,
    suns: np.ndarray,
    settings: TransportSettings = USUAL_TRANSPORT,
) -> LightTransport:
    """The same light transport with more directions, in the unit of the others: suns (S, 3), as the points see them."""
    if not len(suns):
        return transport
    shadows = [sun_visibility(points.position, points.normal, caster, sun, settings) for sun in suns]
    visible = np.stack(shadows, axis=1)
    cosine = np.maximum(points.normal @ suns.T, 0.0).astype(np.float32)
    return replace(
        transport,
        directions=np.concatenate([transport.directions, suns.astype(np.float32)]),
        visible=np.concatenate([transport.visible, visible], axis=1),
        direct=np.concatenate([transport.direct, np.float32(transport.share) * visible * cosine], axis=1),
        suns=transport.suns + len(suns),
    )


def sun_visibility(
    position: np.ndarray,
    normal: np.ndarray,
    caster: Raycaster,
    sun: np.ndarray,
    settings: TransportSettings = USUAL_TRANSPORT,
) -> np.ndarray:
    """(N,) float32: how much of a sun in direction (3,) is seen from surface points (N, 3) with normals (N, 3)."""
    visible = np.zeros(len(position), np.float32)
    lit = np.flatnonzero(normal @ sun > 0.0)
    origin = np.asarray(position[lit] + settings.lift * normal[lit], np.float32)
    across = np.cross(sun, (0.0, 0.0, 1.0) if abs(sun[2]) < 0.9 else (1.0, 0.0, 0.0))
    across *= settings.sun_radius / np.linalg.norm(across)
    for aside in (across, -across, np.cross(sun, across), np.cross(across, sun)):
        direction = np.broadcast_to(np.asarray(sun + aside, np.float32), origin.shape).copy()
        visible[lit] += np.float32(0.25) * ~caster.all_blocked(origin, direction)
    return visible


def bounced(transport: LightTransport, leaving: np.ndarray) -> np.ndarray:
    """(C, N) float32 light that arrives from the mesh when `leaving` (C, N) leaves it."""
    arriving = np.zeros_like(leaving)
    _bounced(transport.indptr, transport.indices, transport.weight, leaving, arriving)
    return arriving + transport.lost[:, None] * leaving.mean(axis=0)


@njit_parallel
def _bounced(
    indptr: np.ndarray, indices: np.ndarray, weight: np.ndarray, leaving: np.ndarray, arriving: np.ndarray
) -> None:
    """Sparse rows times (C, N), added to `arriving` (C, N)."""
    for c in prange(len(indptr) - 1):
        for i in range(indptr[c], indptr[c + 1]):
            for n in range(leaving.shape[1]):
                arriving[c, n] += weight[i] * leaving[indices[i], n]
