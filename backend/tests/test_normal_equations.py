"""A Gauss-Newton step against the same one made the long way: all unknowns, albedo too, in dense float64 matrices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from dante_w.traced.light_transport import sphere
from dante_w.traced.solver import pcg as channels
from dante_w.traced.solver.normal_equations import Equations, ExposurePrior, prior_precision, step
from dante_w.traced.solver.smoothness_prior import smoothness_laplacian

POINTS, PHOTOS, LIGHTS, DIRECTIONS = 14, 6, 2, 12
LIGHT = np.array([0, 1, 0, 1, 1, 0])
#: What the method is documented to assume, written down here again so that no number of the code's is held against itself:
#: the weight of an observation (of standard deviation 0.15 / 0.1**0.5) beside the prior, the standard deviations of the log of
#: albedo's level and of a step of a sun, and the longest step.
OBSERVED, LEVEL, SUN, LONGEST = 1.0 / 0.225, 0.35, 0.3, 1.5


@pytest.fixture
def to_the_end(monkeypatch):
    """Solutions are iterated until rounding is all that is left."""
    monkeypatch.setattr(channels, "TOLERANCE", 1e-10)


def precisions(suns: int) -> tuple[np.ndarray, np.ndarray]:
    """Inverse covariances of log light in brightness and in colour: Gaussian processes on the sphere; of suns, that of a step."""
    directions = sphere(DIRECTIONS)[: DIRECTIONS - suns]
    angle = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))
    found = []
    for deviation, length, mean in ((2.0, 0.5, 0.1), (0.15, 0.8, 0.1)):
        whole = np.eye(DIRECTIONS) / SUN**2
        covariance = deviation**2 * np.exp(-angle / length) + mean**2 + 1e-4 * np.eye(len(angle))
        whole[: len(angle), : len(angle)] = np.linalg.inv(covariance)
        found.append(whole)
    return found[0], found[1]


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
        light=LIGHT,
        level=random.normal(0.0, 0.3, shape).astype(np.float32),
        known=random.uniform(0.0, 1.0, (POINTS, 3)) * (random.random((POINTS, 1)) < 0.5),
        known_residual=random.normal(0.0, 0.2, (POINTS, 3)),
        log_albedo=(log_albedo := random.normal(-1.0, 0.3, (POINTS, 3)).astype(np.float32)),
        even=smoothness_laplacian(random.normal(0.0, 1.0, (POINTS, 3)), log_albedo, random),
        suns=suns,
    )
    return equations, random.normal(0.0, 0.3, PHOTOS), ExposurePrior(random.normal(0.0, 0.3, PHOTOS), 0.2)


def the_long_way(
    of: Equations, exposure: np.ndarray, expected: ExposurePrior
) -> tuple[np.ndarray, np.ndarray, float]:
    """The undamped step, from the derivatives that autograd finds of what each observation is predicted to be."""
    sizes = (LIGHTS * DIRECTIONS * 3, PHOTOS, 1, POINTS * 3)
    direct, radiance, irradiance, level = (
        torch.from_numpy(np.asarray(array, np.float64))
        for array in (of.direct, of.radiance, of.irradiance, of.level)
    )
    bounce = irradiance - torch.einsum("cd,jdx->cjx", direct, radiance)

    def predicted(unknowns: torch.Tensor) -> torch.Tensor:
        log_light, log_exposure, of_level, log_albedo = torch.split(unknowns, sizes)
        changed = radiance * log_light.reshape(LIGHTS, DIRECTIONS, 3).exp()
        shade = (torch.einsum("cd,jdx->cjx", direct, changed) + bounce) / irradiance
        albedo = log_albedo.reshape(POINTS, 3)
        seen = albedo[of.point] + shade[of.point, of.light[of.photo]].log()
        seen = seen + log_exposure[of.photo, None] + of_level * level
        return torch.cat([seen.reshape(-1), albedo.reshape(-1)])

    slopes = torch.autograd.functional.jacobian(
        predicted, torch.zeros(sum(sizes), dtype=torch.float64)
    ).numpy()
    weight = OBSERVED * of.counts * np.concatenate([of.weight.ravel(), of.known.ravel()]).astype(np.float64)
    at_rest = torch.zeros(sizes[0], dtype=torch.float64)

    def eliminated(log_light: torch.Tensor) -> torch.Tensor:
        changed = radiance * log_light.reshape(LIGHTS, DIRECTIONS, 3).exp()
        shade = (torch.einsum("cd,jdx->cjx", direct, changed) + bounce) / irradiance
        left = torch.from_numpy(of.residual) - shade[of.point, of.light[of.photo]].log()
        trust = torch.from_numpy(of.weight).double()
        known = torch.from_numpy(of.known)
        told = (known * torch.from_numpy(of.known_residual)).index_add(
            0, torch.from_numpy(of.point), trust * left
        )
        best = told / known.index_add(0, torch.from_numpy(of.point), trust).add(1e-9)
        return (torch.from_numpy(of.log_albedo) + best).T.reshape(-1)

    residual = np.concatenate([of.residual.ravel(), of.known_residual.ravel()])
    matrix = slopes.T @ (weight[:, None] * slopes)
    right = slopes.T @ (weight * residual)
    even = OBSERVED * of.counts * np.kron(np.eye(3), of.even.to_dense().numpy())
    falls = torch.autograd.functional.jacobian(eliminated, at_rest).numpy()
    matrix[: sizes[0], : sizes[0]] += falls.T @ even @ falls
    right[: sizes[0]] -= falls.T @ even @ eliminated(at_rest).numpy()

    brightness, colour = precisions(of.suns)
    grey = np.full((3, 3), 1.0 / 3.0)
    pull = np.kron(brightness, grey) + np.kron(
        colour, np.eye(3) - grey
    )  # unknowns by direction, then channel
    pull = np.kron(np.eye(LIGHTS), pull)
    light, photos = slice(0, sizes[0]), slice(sizes[0], sizes[0] + PHOTOS)
    matrix[light, light] += pull
    log_radiance = np.log(of.radiance.astype(np.float64))
    log_radiance[:, DIRECTIONS - of.suns :] = 0.0  # nothing is known of suns: they are pulled nowhere
    right[light] -= pull @ log_radiance.ravel()
    away = exposure - expected.mean
    matrix[photos, photos] += np.eye(PHOTOS) / expected.deviation**2
    right[photos] -= (away - away.mean()) / expected.deviation**2
    matrix[sizes[0] + PHOTOS, sizes[0] + PHOTOS] += LEVEL**-2
    change = np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
    level = change[sizes[0] + PHOTOS]
    return change[light].reshape(LIGHTS, DIRECTIONS, 3), change[photos], level


def taken(of: Equations, exposure: np.ndarray, expected: ExposurePrior, damping: float = 0.0):
    directions = sphere(DIRECTIONS).astype(np.float32)
    *change, rate = step(of, exposure, expected, prior_precision(directions, of.suns), damping)
    assert rate == 1.0
    return tuple(change)


def agree(found, wanted) -> None:
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-4 * np.abs(theirs).max() + 1e-7)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_step_is_the_one_of_all_unknowns_together(seed, to_the_end):
    of, exposure, expected = problem(seed)
    # near the prior's mean, or the longest step cuts it short
    of = dataclasses.replace(
        of, radiance=of.radiance**0.2, irradiance=of.irradiance * 2.0, counts=(1.0, 2.0, 0.5)[seed]
    )
    wanted = the_long_way(of, exposure, expected)
    assert np.abs(wanted[0]).max() < LONGEST
    agree(taken(of, exposure, expected), wanted)


@pytest.mark.parametrize("suns", [1, 2])
def test_suns_are_held_to_a_step_and_pulled_nowhere(suns, to_the_end):
    of, exposure, expected = problem(4, suns)
    of = dataclasses.replace(of, radiance=of.radiance**0.2, irradiance=of.irradiance * 2.0)
    of.radiance[:, DIRECTIONS - suns :] *= np.float32(2.0)  # away from the mean of the prior
    wanted = the_long_way(of, exposure, expected)
    assert np.abs(wanted[0][:, DIRECTIONS - suns :]).max() > 0.01 and np.abs(wanted[0]).max() < LONGEST
    agree(taken(of, exposure, expected), wanted)


@pytest.mark.parametrize("without", ["known", "level", "weight of a photo", "a photo"])
def test_parts_may_be_missing(without, to_the_end):
    of, exposure, expected = problem(3)
    of = dataclasses.replace(of, radiance=of.radiance**0.2, irradiance=of.irradiance * 2.0)
    if without in ("known", "level"):
        of = dataclasses.replace(of, **{without: 0.0 * getattr(of, without)})
    elif without == "weight of a photo":
        of = dataclasses.replace(of, weight=np.where(of.photo[:, None] == 2, np.float32(0.0), of.weight))
    else:
        rows = of.photo != 2
        columns = {
            name: getattr(of, name)[rows] for name in ("point", "photo", "weight", "residual", "level")
        }
        of = dataclasses.replace(of, **columns)
    wanted = the_long_way(of, exposure, expected)
    agree(taken(of, exposure, expected), wanted)
    if without == "weight of a photo":
        away = exposure - expected.mean
        assert wanted[1][2] == pytest.approx(-(away - away.mean())[2], rel=1e-6)


def test_damping_shortens_and_no_step_is_long():
    of, exposure, expected = problem(0)
    near = dataclasses.replace(of, radiance=of.radiance**0.2, irradiance=of.irradiance * 2.0)
    lengths = [np.linalg.norm(taken(near, exposure, expected, damping)[0]) for damping in (0.0, 1.0, 100.0)]
    assert lengths[0] > lengths[1] > 1.2 * lengths[2] > 0.0
    far = dataclasses.replace(near, residual=40.0 * of.residual)
    assert np.abs(taken(far, exposure, expected)[0]).max() == pytest.approx(LONGEST)


def test_the_prior_is_rough_in_brightness_and_smooth_in_colour():
    directions = sphere(64)
    brightness, colour = prior_precision(directions)
    flat, slope = np.ones(64), directions[:, 2]
    for log_light in (flat, slope):
        assert log_light @ colour @ log_light > 10.0 * (log_light @ brightness @ log_light) > 0.0
    for precision in (brightness, colour):
        np.testing.assert_allclose(precision, precision.T, rtol=1e-6, atol=1e-6)
        assert np.linalg.eigvalsh(precision).min() > 0.0
