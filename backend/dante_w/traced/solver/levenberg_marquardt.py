"""The Levenberg-Marquardt loop: attempts at steps on log radiance and log exposure, each accepted or rejected by its cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dante_w.traced.light_clusters import reassign_photos
from dante_w.traced.light_transport import LightTransport, bounced
from dante_w.traced.solver.albedo_scale import corrected_brightest, open_gain, with_gain
from dante_w.traced.solver.evidence import Evidence, observed_specular
from dante_w.traced.solver.light_prior import LightPrecision, light_precision
from dante_w.traced.solver.normal_equations import Equations, Step, gauss_newton_step
from dante_w.traced.solver.settings import SolverSettings
from dante_w.traced.solver.smoothness_prior import smoothness_laplacian
from dante_w.traced.solver.step_control import StepControl, damping_of, judge, robust_cost
from dante_w.traced.solver.variable_projection import Projection, project_albedo
from dante_w.traced.state import Lighting


@dataclass(frozen=True)
class Problem:
    """What all steps share: the evidence, how light reaches the points, the prior of the lights, and the settings."""

    evidence: Evidence
    transport: LightTransport
    precision: LightPrecision
    settings: SolverSettings


@dataclass(frozen=True)
class Evaluation:
    """A lighting with the albedo that explains the observations best under it.

    Attributes:
        lighting: with that albedo, its scale and white balance set.
        irradiance: (C, J, 3) of the points under it.
        projection: what the observations say of log albedo.
        cost: mean robust cost of the observations, see `robust_cost`.
    """

    lighting: Lighting
    irradiance: np.ndarray
    projection: Projection
    cost: float

    @property
    def unknowns(self) -> tuple[np.ndarray, ...]:
        """What has to be finite."""
        return self.lighting.radiance, self.lighting.log_exposure, self.lighting.albedo


def minimise(
    lighting: Lighting,
    transport: LightTransport,
    evidence: Evidence,
    settings: SolverSettings,
    steps: range,
    seed: int,
    progress: Callable[[int], None],
) -> Lighting:
    """Take steps from `lighting`. Returns the last state that was accepted, with the setbacks added to those before.

    Args:
        steps: their numbers, on which damping, clusters and albedo scale depend.
        seed: of the points and pairs that steps look at.
        progress: called with the number of steps taken.
    """
    free = evidence.exposure_prior.free
    precision = light_precision(transport.directions, transport.suns, free, settings.light_prior)
    problem = Problem(evidence, transport, precision, settings)
    reassignments = dict(settings.reassignment_steps) if evidence.components.clusters else {}
    generator = np.random.default_rng(seed)
    rules = settings.step_control

    step, control = steps.start, StepControl(setbacks=lighting.setbacks)
    state = evaluate(problem, lighting, step)
    control, result = judge(control, step, steps.stop, state.cost, state.unknowns, rules)
    accepted = state.lighting if result.accepted else lighting
    while step < steps.stop and not control.exhausted:
        lighting = _with_bounce(problem, state) if evidence.components.bounce else state.lighting
        if step in reassignments:
            lighting = _reassigned(problem, state, lighting, reassignments[step])
            control = control.restarted()
        else:
            equations = _linearised(problem, state, lighting, generator)
            change = gauss_newton_step(
                equations,
                lighting.log_exposure,
                evidence.exposure_prior,
                precision,
                damping_of(step, control, rules),
                settings.equations,
            )
            control = control.damped(step, change.damping_factor)
            lighting = _moved(lighting, change)
            if step == settings.albedo_scale.step and len(lighting.radiance) > 1:  # one light leaves it open
                brightest = corrected_brightest(change.log_albedo_scale, settings.albedo_scale)
                lighting = replace(lighting, brightest_albedo=brightest)
                control = control.restarted()
        progress(step + 1)
        trial = evaluate(problem, lighting, step + 1)
        control, result = judge(control, step + 1, steps.stop, trial.cost, trial.unknowns, rules)
        if result.accepted:
            step, state, accepted = step + 1, trial, trial.lighting
        else:
            state = evaluate(problem, accepted, step)
    return replace(accepted, setbacks=control.setbacks)


def evaluate(problem: Problem, lighting: Lighting, step: int) -> Evaluation:
    """Project the albedo under `lighting`, give it its scale and white balance, and compute the cost."""
    evidence, transport, settings = problem.evidence, problem.transport, problem.settings
    irradiance = lighting.irradiance(transport)
    if evidence.components.specular and step >= settings.steps_without_specular:
        specular = observed_specular(evidence, transport, lighting, settings.specular)
    else:
        specular = np.zeros((len(evidence.observations.point), 3), np.float32)
    log_albedo, projection = project_albedo(lighting, irradiance, specular, evidence, settings.projection)
    gain = open_gain(log_albedo, lighting, evidence, settings.albedo_scale)
    lighting = with_gain(lighting, log_albedo, gain)
    if gain.light.any():
        irradiance = lighting.irradiance(transport)
    projection = replace(projection, log_albedo=projection.log_albedo + gain.albedo)
    error = projection.diffuse * projection.residual / settings.projection.outlier
    return Evaluation(lighting, irradiance, projection, robust_cost(evidence.weight, error))


def _with_bounce(problem: Problem, state: Evaluation) -> Lighting:
    """The lighting of `state` with the light that leaves the mesh under it and meets it again."""
    albedo = np.minimum(state.lighting.albedo, problem.settings.highest_bouncing)
    leaving = albedo[:, None, :] * state.irradiance
    arriving = bounced(problem.transport, leaving.reshape(len(leaving), -1)).reshape(leaving.shape)
    return replace(state.lighting, bounce=arriving)


def _reassigned(problem: Problem, state: Evaluation, lighting: Lighting, as_good: float) -> Lighting:
    """`lighting` with photos moved to the light that explains them best, and without the lights that are given up."""
    observations = problem.evidence.observations
    light = lighting.cluster[observations.photo]
    cluster, kept = reassign_photos(
        state.projection.log_albedo + np.log(state.irradiance)[observations.point, light],
        state.irradiance,
        problem.evidence.weight,
        observations,
        lighting,
        as_good,
        problem.settings.reassignment,
    )
    return replace(
        lighting, radiance=lighting.radiance[kept], cluster=cluster, bounce=lighting.bounce[:, kept]
    )


def _moved(lighting: Lighting, change: Step) -> Lighting:
    radiance = np.exp(np.log(lighting.radiance) + change.log_radiance).astype(np.float32)
    return replace(lighting, radiance=radiance, log_exposure=lighting.log_exposure + change.log_exposure)


def _linearised(
    problem: Problem, state: Evaluation, lighting: Lighting, generator: np.random.Generator
) -> Equations:
    """The equations of the points of one step, drawn from those that are known.

    Args:
        lighting: that of `state`, its bounced light brought up to date.
    """
    evidence, settings = problem.evidence, problem.settings
    observations, prior, projection = evidence.observations, evidence.albedo_prior, state.projection
    known = np.flatnonzero(lighting.known)
    chosen = np.sort(generator.permutation(known)[: settings.points_per_step])
    log_albedo = np.log(lighting.albedo[chosen])
    position = evidence.points.position[chosen]
    smoothness = smoothness_laplacian(position, log_albedo, generator, settings.smoothness)

    number = np.full(len(evidence.points), -1)
    number[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(number[observations.point] >= 0)
    point, photo = observations.point[rows], observations.photo[rows]
    light = lighting.cluster[photo]
    bounced_share = lighting.bounce[point, light] / state.irradiance[point, light]
    return Equations(
        point=number[point],
        photo=photo,
        weight=projection.weight[rows],
        residual=projection.residual[rows],
        scale_jacobian=bounced_share - (1.0 / projection.diffuse[rows] - 1.0),
        direct=problem.transport.direct[chosen],
        irradiance=state.irradiance[chosen],
        radiance=lighting.radiance,
        cluster=lighting.cluster,
        prior_weight=np.repeat(prior.weight[chosen, None], 3, axis=1),
        prior_residual=prior.log_albedo[chosen] - log_albedo,
        log_albedo=log_albedo,
        smoothness=smoothness,
        suns=problem.transport.suns,
        point_weight=max(evidence.points.side / settings.counted_side, 1.0),
    )
