"""A Gauss-Newton step against the same one made the long way: all unknowns, albedo too, in dense float64 matrices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from dante_w.traced.light_transport import sphere
from dante_w.traced.solver.evidence import ExposurePrior
from dante_w.traced.solver.light_prior import LightPriorSettings, light_precision
from dante_w.traced.solver.normal_equations import Equations, EquationSettings, gauss_newton_step
from dante_w.traced.solver.pcg import PcgSettings
from dante_w.traced.solver.smoothness_prior import SmoothnessSettings, smoothness_laplacian

POINTS, PHOTOS, LIGHTS, DIRECTIONS = 14, 6, 2, 12
CLUSTER = np.array([0, 1, 0, 1, 1, 0])
#: Solutions are iterated until rounding is all that is left.
TO_THE_END = EquationSettings(pcg=PcgSettings(tolerance=1e-10))
#: What the method is documented to assume, written down here again so that no number of the code's is held against itself:
#: the weight of an observation (of standard deviation 0.15 / 0.1**0.5) beside the prior, the standard deviations of the log of
#: the albedo scale and of a step of a sun, and the longest step.
OBSERVED, SCALE, SUN, LONGEST = 1.0 / 0.225, 0.35, 0.3, 1.5


def precisions(suns: int) -> tuple[np.ndarray, np.ndarray]:
    """Inverse covariances of log light in brightness and in colour: Gaussian processes on the sphere; of suns, that of a step."""
    directions = sphere(DIRECTIONS)[: DIRECTIONS - suns]
    angle = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))
    matrices = []
    for deviation, length, mean in ((2.0, 0.5, 0.1), (0.15, 0.8, 0.1)):
        whole = np.eye(DIRECTIONS) / SUN**2
        covariance = deviation**2 * np.exp(-angle / length) + mean**2 + 1e-4 * np.eye(len(angle))
        whole[: len(angle), : len(angle)] = np.linalg.inv(covariance)
        matrices.append(whole)
    return matrices[0], matrices[1]


def problem(seed: int = 0, suns: int = 0) -> tuple[Equations, np.ndarray, ExposurePrior]:
    """Equations with a bit of everything, log exposures, and what is expected of these."""
    random = np.random.default_rng(seed)
    photo, point = np.nonzero(random.random((PHOTOS, POINTS)) < 0.8)
    shape = (len(point), 3)
    direct = random.uniform(0.0, 0.4, (POINTS, DIRECTIONS)).astype(np.float32)
    radiance = np.exp(random.normal(0.0, 0.5, (LIGHTS, DIRECTIONS, 3))).astype(np.float32)
    bounce = random.uniform(0.0, 0.5, (POINTS, LIGHTS, 3))
    equations = Equations(
        point=point,
        photo=photo,
        weight=random.uniform(0.0, 1.0, shape).astype(np.float32),
        residual=random.normal(0.0, 0.1, shape).astype(np.float32),
        direct=direct,
        irradiance=(np.tensordot(direct, radiance, axes=(1, 1)) + bounce).astype(np.float32),
        radiance=radiance,
        cluster=CLUSTER,
        scale_jacobian=random.normal(0.0, 0.3, shape).astype(np.float32),
        prior_weight=random.uniform(0.0, 1.0, (POINTS, 3)) * (random.random((POINTS, 1)) < 0.5),
        prior_residual=random.normal(0.0, 0.2, (POINTS, 3)),
        log_albedo=(log_albedo := random.normal(-1.0, 0.3, (POINTS, 3)).astype(np.float32)),
        smoothness=smoothness_laplacian(
            random.normal(0.0, 1.0, (POINTS, 3)), log_albedo, random, SmoothnessSettings()
        ),
        suns=suns,
    )
    return (
        equations,
        random.normal(0.0, 0.3, PHOTOS),
        ExposurePrior(random.normal(0.0, 0.3, PHOTOS), 0.2, free=True),
    )


def the_long_way(
    equations: Equations, exposure: np.ndarray, expected: ExposurePrior
) -> tuple[np.ndarray, np.ndarray, float]:
    """The undamped step, from the derivatives that autograd finds of what each observation is predicted to be."""
    sizes = (LIGHTS * DIRECTIONS * 3, PHOTOS, 1, POINTS * 3)
    direct, radiance, irradiance, by_scale = (
        torch.from_numpy(np.asarray(getattr(equations, name), np.float64))
        for name in ("direct", "radiance", "irradiance", "scale_jacobian")
    )
    light = CLUSTER[equations.photo]
    bounce = irradiance - torch.einsum("cd,jdx->cjx", direct, radiance)

    def predicted(unknowns: torch.Tensor) -> torch.Tensor:
        log_light, log_exposure, log_scale, log_albedo = torch.split(unknowns, sizes)
        changed = radiance * log_light.reshape(LIGHTS, DIRECTIONS, 3).exp()
        shade = (torch.einsum("cd,jdx->cjx", direct, changed) + bounce) / irradiance
        albedo = log_albedo.reshape(POINTS, 3)
        colour = albedo[equations.point] + shade[equations.point, light].log()
        colour = colour + log_exposure[equations.photo, None] + log_scale * by_scale
        return torch.cat([colour.reshape(-1), albedo.reshape(-1)])

    slopes = torch.autograd.functional.jacobian(
        predicted, torch.zeros(sum(sizes), dtype=torch.float64)
    ).numpy()
    counts = OBSERVED * equations.point_weight
    weights = np.concatenate([equations.weight.ravel(), equations.prior_weight.ravel()])
    weight = counts * weights.astype(np.float64)
    at_rest = torch.zeros(sizes[0], dtype=torch.float64)

    def eliminated(log_light: torch.Tensor) -> torch.Tensor:
        changed = radiance * log_light.reshape(LIGHTS, DIRECTIONS, 3).exp()
        shade = (torch.einsum("cd,jdx->cjx", direct, changed) + bounce) / irradiance
        residual = torch.from_numpy(equations.residual) - shade[equations.point, light].log()
        observed, known = (
            torch.from_numpy(each).double() for each in (equations.weight, equations.prior_weight)
        )
        point = torch.from_numpy(equations.point)
        weighted = known * torch.from_numpy(equations.prior_residual)
        weighted = weighted.index_add(0, point, observed * residual)
        best = weighted / known.index_add(0, point, observed).add(1e-9)
        return (torch.from_numpy(equations.log_albedo) + best).T.reshape(-1)

    residual = np.concatenate([equations.residual.ravel(), equations.prior_residual.ravel()])
    matrix = slopes.T @ (weight[:, None] * slopes)
    right = slopes.T @ (weight * residual)
    smoothness = counts * np.kron(np.eye(3), equations.smoothness.to_dense().numpy())
    slope = torch.autograd.functional.jacobian(eliminated, at_rest).numpy()
    matrix[: sizes[0], : sizes[0]] += slope.T @ smoothness @ slope
    right[: sizes[0]] -= slope.T @ smoothness @ eliminated(at_rest).numpy()

    brightness, colour = precisions(equations.suns)
    grey = np.full((3, 3), 1.0 / 3.0)
    prior = np.kron(brightness, grey) + np.kron(
        colour, np.eye(3) - grey
    )  # unknowns by direction, then channel
    prior = np.kron(np.eye(LIGHTS), prior)
    lights, photos = slice(0, sizes[0]), slice(sizes[0], sizes[0] + PHOTOS)
    matrix[lights, lights] += prior
    log_radiance = np.log(equations.radiance.astype(np.float64))
    log_radiance[:, DIRECTIONS - equations.suns :] = 0.0  # nothing is known of suns: no prior pulls them
    right[lights] -= prior @ log_radiance.ravel()
    difference = exposure - expected.mean
    matrix[photos, photos] += np.eye(PHOTOS) / expected.deviation**2
    right[photos] -= (difference - difference.mean()) / expected.deviation**2
    matrix[sizes[0] + PHOTOS, sizes[0] + PHOTOS] += SCALE**-2
    change = np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
    scale = change[sizes[0] + PHOTOS]
    return change[lights].reshape(LIGHTS, DIRECTIONS, 3), change[photos], scale


def step(equations: Equations, exposure: np.ndarray, expected: ExposurePrior, damping: float = 0.0):
    directions = sphere(DIRECTIONS).astype(np.float32)
    precision = light_precision(directions, equations.suns, expected.free, LightPriorSettings())
    change = gauss_newton_step(equations, exposure, expected, precision, damping, TO_THE_END)
    assert change.damping_factor == 1.0
    return change.log_radiance, change.log_exposure, change.log_albedo_scale


def near_the_mean(equations: Equations) -> Equations:
    """With lights near the mean of their prior, or the longest step would cut each one short."""
    return dataclasses.replace(
        equations, radiance=equations.radiance**0.2, irradiance=equations.irradiance * 2.0
    )


def agree(solution, wanted) -> None:
    for ours, theirs in zip(solution, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-4 * np.abs(theirs).max() + 1e-7)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_step_is_the_one_of_all_unknowns_together(seed):
    equations, exposure, expected = problem(seed)
    equations = dataclasses.replace(near_the_mean(equations), point_weight=(1.0, 2.0, 0.5)[seed])
    wanted = the_long_way(equations, exposure, expected)
    assert np.abs(wanted[0]).max() < LONGEST
    agree(step(equations, exposure, expected), wanted)


@pytest.mark.parametrize("suns", [1, 2])
def test_suns_are_held_to_a_step_and_pulled_nowhere(suns):
    equations, exposure, expected = problem(4, suns)
    equations = near_the_mean(equations)
    equations.radiance[:, DIRECTIONS - suns :] *= np.float32(2.0)  # away from the mean of the prior
    wanted = the_long_way(equations, exposure, expected)
    assert np.abs(wanted[0][:, DIRECTIONS - suns :]).max() > 0.01 and np.abs(wanted[0]).max() < LONGEST
    agree(step(equations, exposure, expected), wanted)


@pytest.mark.parametrize("without", ["prior_weight", "scale_jacobian", "weight of a photo", "a photo"])
def test_components_may_be_missing(without):
    equations, exposure, expected = problem(3)
    equations = near_the_mean(equations)
    if without in ("prior_weight", "scale_jacobian"):
        equations = dataclasses.replace(equations, **{without: 0.0 * getattr(equations, without)})
    elif without == "weight of a photo":
        weight = np.where(equations.photo[:, None] == 2, np.float32(0.0), equations.weight)
        equations = dataclasses.replace(equations, weight=weight)
    else:
        rows = equations.photo != 2
        names = "point", "photo", "weight", "residual", "scale_jacobian"
        equations = dataclasses.replace(equations, **{name: getattr(equations, name)[rows] for name in names})
    wanted = the_long_way(equations, exposure, expected)
    agree(step(equations, exposure, expected), wanted)
    if without == "weight of a photo":
        difference = exposure - expected.mean
        assert wanted[1][2] == pytest.approx(-(difference - difference.mean())[2], rel=1e-6)


def test_damping_shortens_and_no_step_is_long():
    equations, exposure, expected = problem(0)
    near = near_the_mean(equations)
    lengths = [np.linalg.norm(step(near, exposure, expected, damping)[0]) for damping in (0.0, 1.0, 100.0)]
    assert lengths[0] > lengths[1] > 1.2 * lengths[2] > 0.0
    far = dataclasses.replace(near, residual=40.0 * equations.residual)
    assert np.abs(step(far, exposure, expected)[0]).max() == pytest.approx(LONGEST)


def test_the_light_prior_is_rough_in_brightness_and_smooth_in_colour():
    directions = sphere(64)
    precision = light_precision(directions, 0, True, LightPriorSettings())
    flat, slope = np.ones(64), directions[:, 2]
    for log_light in (flat, slope):
        rough, smooth = (log_light @ each @ log_light for each in (precision.brightness, precision.colour))
        assert smooth > 10.0 * rough > 0.0
    for each in (precision.brightness, precision.colour):
        np.testing.assert_allclose(each, each.T, rtol=1e-6, atol=1e-6)
        assert np.linalg.eigvalsh(each).min() > 0.0
