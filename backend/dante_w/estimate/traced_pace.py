"""How fast this machine traces light and solves for it, from the run itself in small: `dante_w.estimate.pace` for traced light."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from dante_w.estimate.pace import Sample, timed
from dante_w.rays.ray_cache import RayCache
from dante_w.rays.raycast import Raycaster
from dante_w.texture.photo_average import PhotoAverage
from dante_w.traced.albedo_texture import albedo_texture
from dante_w.traced.light_clusters import USUAL_CLUSTERS
from dante_w.traced.light_transport import LightTransport, sphere, trace_light_transport
from dante_w.traced.model_selection import USUAL_SELECTION
from dante_w.traced.observations import USUAL_THINNING, Observations
from dante_w.traced.shading_points import ShadingPoints, ShadingSettings, gather
from dante_w.traced.solver.albedo_scale import open_gain, with_gain
from dante_w.traced.solver.evidence import gather_evidence, observed_specular
from dante_w.traced.solver.settings import USUAL_SOLVER as SOLVER
from dante_w.traced.solver.variable_projection import project_albedo
from dante_w.traced.state import Lighting, TracedScene
from dante_w.traced.sun import USUAL_SUN

#: Points traced, observations explained, samples given an albedo, and texels a side filled at most; and of samples and
#: observations before them, which only load kernels.
TRACED, EXPLAINED, DIVIDED, SIDE, FEW = 256, 1 << 18, 1 << 17, 512, 64
#: How often what takes milliseconds is timed.
TIMED = 5
#: Rows and columns of the matrices multiplied and factored.
MULTIPLIED, FACTORED = (2048, 512), 1536
#: Array code that is not timed, in observations explained: to sum up what a point of a step shows and pair it with its neighbours, to
#: tell how it answers to one direction of one light, to look for a sun at a point, to weigh an observation's residual, to compare one of a
#: photo with one light, and to prepare one for a fit and score it. From one profile of one object on one machine.
SUMMED, ANSWERED, SEARCHED, WEIGHED, COMPARED, PREPARED = 150, 0.25, 100, 0.2, 0.45, 1.2
#: What conjugate gradients take, as rows of the matrices multiplied. From the same profile.
ITERATED = 14_000
#: Seconds of a point, a row or a sample among many, per second of one among few: caches and threads are warm. Set by
#: hand, as the numbers above, from profiles and from eight runs of four objects.
MANY_TRACED, MANY_MULTIPLIED, MANY_FACTORED, MANY_DIVIDED = 0.55, 1.8, 0.5, 0.6
#: Lights that photos have, if there are as many photos; what is not known until they are compared. Four objects under five
#: lights end with 5 to 8.
LIGHTS = 7


@dataclass(frozen=True)
class TracedWork:
    """How much is to be done: photos, their samples, shading points, observations of these, directions of light, lights at
    first and in the end, and texels; whether suns are looked for, and whether lights go on from the plan's."""

    photos: int
    samples: float
    points: float
    observations: float
    directions: int
    first_lights: int
    lights: int
    texels: int
    suns: bool
    goes_on: bool


@dataclass(frozen=True)
class TracedPace:
    """Seconds on this machine: to `gather` a sample, `trace` a point in all directions, `explain` an observation and `level`
    a point beside that, compute an observation's sheen for a direction (`shine`), `multiply` in float32 and in float64 (`factor`), make the `albedo` of a sample and
    `fill` a texel."""

    gather: float
    trace: float
    explain: float
    level: float
    shine: float
    multiply: float
    factor: float
    albedo: float
    fill: float


def measure_traced(
    sample: Sample,
    photos: int,
    pixels: int,
    directions: int,
    texels: int,
    suns: bool,
    goes_on: bool,
    finer: int = 1,
) -> tuple[TracedPace, TracedWork]:
    """Do a little of everything and time it, in less than a second once kernels are loaded; and how much there is to do with
    all the `photos`, their `pixels`, so many `directions` of light and `texels`, `suns` or none, lights that go on from the
    plan's or not (`goes_on`), and shading points as much `finer` as `gather` has them."""
    cache = _first(sample.cache, len(sample.cache))
    cameras = np.full((len(cache.starts) - 1, 3), 3.0)  # any place will do
    gather(_first(cache, FEW), cameras)
    (points, seen), gathering = timed(lambda: gather(cache, cameras, ShadingSettings(side=256 * finer)))
    transfer, tracing = _trace(points, cache, sample.caster, directions)
    lights = _grey_lights(points, cameras, transfer)
    irradiance = lights.irradiance(transfer)

    def explained(rows: Observations) -> tuple[float, float]:
        """Seconds of the sheen and of the rest, as usual among a few."""
        evidence, seconds = gather_evidence(points, rows, cameras, SOLVER.evidence), []

        def project(specular: np.ndarray) -> Lighting:
            log_albedo, _ = project_albedo(lights, irradiance, specular, evidence, SOLVER.projection)
            gain = open_gain(log_albedo, lights, evidence, SOLVER.albedo_scale)
            return with_gain(lights, log_albedo, gain)

        for _ in range(TIMED):
            specular, shining = timed(lambda: observed_specular(evidence, transfer, lights, SOLVER.specular))
            seconds.append((shining, timed(partial(project, specular))[1]))
        usual, rest = np.median(seconds, axis=0)
        return float(usual), float(rest)

    def divided(some: RayCache, side: int) -> float:
        assert some.footprint is not None
        rows = seen.take(seen.photo < len(some.starts) - 1)
        scene = TracedScene(cameras, points, rows, transfer, None, None, lights.cluster)
        return timed(lambda: albedo_texture(some, scene, lights, side, lambda _: None))[1]

    hardly_any, rows = (seen.take(np.arange(min(len(seen.point), count))) for count in (FEW, EXPLAINED))
    levelling = explained(hardly_any)[1]
    shining, explaining = explained(rows)
    side = min(math.isqrt(texels), SIDE)
    divided(_first(cache, FEW), 1)
    some = _first(cache, DIVIDED)
    filling = timed(lambda: PhotoAverage(side, side).resolve())[1] / side**2
    pace = TracedPace(
        gather=gathering / len(cache),
        trace=tracing,
        explain=max(explaining - levelling, 0.1 * explaining) / max(len(rows.point), 1),
        level=levelling / len(points),
        shine=shining / max(len(rows.point), 1) / directions,
        multiply=_multiplying(),
        factor=_factoring(),
        albedo=max(divided(some, side) - filling * side**2, 0.0) / len(some),
        fill=filling,
    )
    # what more photos show of the texture, these show too, but for what lies behind
    shown = len(seen.point) / (len(cache.starts) - 1)
    work = TracedWork(
        photos=photos,
        samples=sample.foreground * sample.hit * pixels,
        points=len(points),
        observations=min(shown * photos, USUAL_THINNING.photos * len(points)),
        directions=directions,
        first_lights=min(USUAL_CLUSTERS.clusters, photos),
        lights=min(LIGHTS, photos),
        texels=texels,
        suns=suns,
        goes_on=goes_on,
    )
    return pace, work


def predict_traced(pace: TracedPace, work: TracedWork) -> dict[str, float]:
    """Seconds of the stages between `rays` and `bake`, in their order."""
    observations, few = work.observations, min(SOLVER.coarse_directions, work.directions)
    reassigned = [step for step, _ in SOLVER.reassignment_steps]

    def step(lights: int, directions: int) -> float:
        """The equations of a Gauss-Newton step, made and solved."""
        chosen = min(SOLVER.points_per_step, work.points)
        unknowns = lights * directions
        equations = pace.multiply * (3.0 * MANY_MULTIPLIED * chosen + ITERATED) * unknowns**2
        equations += MANY_FACTORED * pace.factor * 2.0 * unknowns**3 / 6.0
        return equations + (ANSWERED * unknowns + SUMMED) * chosen * pace.explain

    def refined(steps: int, directions: int, share: float) -> float:
        """What so many steps take beside their equations, with a share of the observations; they look once more in the end."""
        look = share * observations * ((1.0 + WEIGHED) * pace.explain + directions * pace.shine)
        return (steps + 1) * (look + work.points * pace.level)

    def regrouped(lights: int, share: float) -> float:
        return COMPARED * lights * share * observations * pace.explain

    def cold(first: int, lights: int, share: float) -> float:
        """All first steps; those after which photos change their light have no equations."""
        early, grouped = min(reassigned), len(reassigned) if first > 1 else 0
        equations = early * step(first, few) + (SOLVER.coarse_steps - early - grouped) * step(lights, few)
        return refined(SOLVER.coarse_steps, few, share) + equations + grouped * regrouped(first, share)

    def again(lights: int, share: float) -> float:
        """The last of the first steps, from another fit."""
        steps = SOLVER.continued_steps
        grouped = sum(done >= SOLVER.coarse_steps - steps for done in reassigned) if lights > 1 else 0
        equations = (steps - grouped) * step(lights, few) + grouped * regrouped(lights, share)
        return refined(steps, few, share) + equations

    first, lights, trial = work.first_lights, work.lights, 1.0 / USUAL_SELECTION.one_in
    # five fits: several lights and one from the start, without gloss from there, and one of these without exposures
    trials = cold(first, lights, trial) + cold(1, 1, trial) + 2.0 * again(lights, trial) + again(1, trial)
    prepared = PREPARED * observations * pace.explain
    coarse = again(lights, 1.0) if work.goes_on else cold(first, lights, 1.0)
    fine = SOLVER.fine_steps * step(lights, work.directions)
    fine += refined(SOLVER.fine_steps, work.directions, 1.0)
    suns = 0.0
    if work.suns:
        suns = lights * SEARCHED * work.points * pace.explain
        steps = USUAL_SUN.steps
        suns += steps * step(lights, work.directions) + refined(steps, work.directions, 1.0)
    return {
        "transfer": work.samples * pace.gather + work.points * pace.trace * MANY_TRACED,
        "plan": trials + 5 * prepared,
        "lights": coarse + fine + suns + prepared,
        "albedo": work.samples * pace.albedo * MANY_DIVIDED + work.texels * pace.fill,
    }


def _trace(
    points: ShadingPoints, cache: RayCache, caster: Raycaster, directions: int
) -> tuple[LightTransport, float]:
    """A transfer with which the points can be computed, though only a few were traced, and the seconds that one takes."""
    chosen = np.random.default_rng(0).permutation(len(points))[:TRACED]
    few = replace(
        points,
        point_of_cell=np.full_like(points.point_of_cell, -1),
        position=points.position[chosen],
        normal=points.normal[chosen],
    )
    uvs = cache.surface.uvs.numpy()
    trace_light_transport(few, caster, uvs, 1, lambda _: None)  # loads kernels
    _, seconds = timed(lambda: trace_light_transport(few, caster, uvs, directions, lambda _: None))
    count = len(points)
    open_sky = np.ones((count, directions), np.float32)
    none = np.zeros(0, np.int32)
    first, lost = np.zeros(count + 1, np.int64), np.zeros(count, np.float32)
    transfer = LightTransport(
        sphere(directions).astype(np.float32), open_sky, open_sky, first, none, none.astype(np.float32), lost
    )
    return transfer, seconds / len(chosen)


def _grey_lights(points: ShadingPoints, cameras: np.ndarray, transfer: LightTransport) -> Lighting:
    """Grey lights, as many as photos will have."""
    photos, count = len(cameras), len(points)
    lights = min(LIGHTS, photos)
    return Lighting(
        np.ones((lights, transfer.parts, 3), np.float32),
        np.arange(photos) % lights,
        np.zeros(photos),
        np.zeros((count, lights, 3), np.float32),
        np.full((count, 3), 0.5, np.float32),
        np.ones(count, bool),
        SOLVER.albedo_scale.brightest,
    )


def _multiplying() -> float:
    rows, columns = MULTIPLIED
    matrix = np.ones((rows, columns), np.float32)
    return _warm(lambda: matrix.T @ matrix) / (rows * columns**2)


def _factoring() -> float:
    matrix = torch.eye(FACTORED, dtype=torch.float64)
    return _warm(lambda: torch.linalg.cholesky_ex(matrix)) / (FACTORED**3 / 6.0)


def _warm(work: Callable[[], object]) -> float:
    """Seconds as usual, once libraries have started their threads."""
    work()
    return float(np.median([timed(work)[1] for _ in range(TIMED)]))


def _first(cache: RayCache, count: int) -> RayCache:
    """The first `count` samples of a cache, and the photos that they are of."""
    some = cache.subset(np.arange(min(count, len(cache))))
    return replace(some, starts=np.unique(some.starts))
