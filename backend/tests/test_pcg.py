"""Equations of three channels against the same ones as one dense matrix in float64."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from dante_w.contract.errors import DanteError
from dante_w.traced.solver.pcg import PcgSettings, Solution, System, solve

LIGHTS, DIRECTIONS, SHARED = 3, 8, 5
SIZE = LIGHTS * DIRECTIONS
SETTINGS = PcgSettings()


def definite(random: np.random.Generator, size: int) -> np.ndarray:
    root = random.normal(0.0, 1.0, (size, size + 3))
    return root @ root.T / size + 0.01 * np.eye(size)


def problem(alike: bool, seed: int = 0) -> tuple[System, torch.Tensor, torch.Tensor]:
    """A system, positive definite as a whole, whose channels are `alike` or not, and a right-hand side."""
    random = np.random.default_rng(seed)
    first = definite(random, SIZE + SHARED)
    parts = [first if alike else definite(random, SIZE + SHARED) * (channel + 1.0) for channel in range(3)]
    channels = np.stack([part[:SIZE, :SIZE] for part in parts])
    cross = np.stack([part[SIZE:, :SIZE] for part in parts])
    shared = sum(part[SIZE:, SIZE:] for part in parts)
    prior = 0.5 * definite(random, DIRECTIONS), 20.0 * definite(random, DIRECTIONS)
    system = System(*(torch.from_numpy(np.asarray(each)) for each in (channels, cross, shared, *prior)))
    right = random.normal(0.0, 1.0, (3, SIZE)), random.normal(0.0, 1.0, SHARED)
    return system, *(torch.from_numpy(each) for each in right)


def dense(system: System) -> np.ndarray:
    """The whole matrix: channels one after another, then what they share."""
    grey, lights = np.full((3, 3), 1.0 / 3.0), np.eye(LIGHTS)
    brightness, colour = system.brightness.numpy(), system.colour.numpy()
    matrix = np.zeros((3 * SIZE + SHARED,) * 2)
    matrix[:-SHARED, :-SHARED] = np.kron(grey, np.kron(lights, brightness)) + np.kron(
        np.eye(3) - grey, np.kron(lights, colour)
    )
    for channel, block in enumerate(system.channels.numpy()):
        place = slice(channel * SIZE, (channel + 1) * SIZE)
        matrix[place, place] += block
        matrix[-SHARED:, place] = system.cross[channel].numpy()
        matrix[place, -SHARED:] = system.cross[channel].numpy().T
    matrix[-SHARED:, -SHARED:] = system.shared.numpy()
    return matrix


def error(solution: Solution, wanted: np.ndarray) -> float:
    return float(
        np.abs(np.r_[solution.x.numpy().ravel(), solution.y.numpy()] - wanted).max() / np.abs(wanted).max()
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("damping", [0.0, 1.0, 50.0])
def test_the_solution_is_that_of_the_whole_matrix(seed, damping):
    system, x, y = problem(alike=False, seed=seed)
    matrix = dense(system)
    matrix += np.diag(0.01 * damping * matrix.diagonal() + 1e-8)
    wanted = np.linalg.solve(matrix, np.r_[x.numpy().ravel(), y.numpy()])
    assert error(solve(system, x, y, damping, SETTINGS), wanted) < 0.01
    exact = dataclasses.replace(SETTINGS, tolerance=1e-10)
    assert error(solve(system, x, y, damping, exact), wanted) < 1e-6


def test_channels_that_are_alike_take_two_iterations():
    """Then what preconditions is all that there is, up to rounding."""
    settings = dataclasses.replace(SETTINGS, iterations=2)
    system, x, y = problem(alike=True)
    wanted = np.linalg.solve(dense(system), np.r_[x.numpy().ravel(), y.numpy()])
    assert error(solve(system, x, y, 0.0, settings), wanted) < 1e-6
    other, x, y = problem(alike=False)
    wanted = np.linalg.solve(dense(other), np.r_[x.numpy().ravel(), y.numpy()])
    assert error(solve(other, x, y, 0.0, settings), wanted) > 1e-3


def test_nothing_to_do_is_done():
    system, x, y = problem(alike=False)
    solution = solve(system, 0.0 * x, 0.0 * y, 1.0, SETTINGS)
    assert not solution.x.any() and not solution.y.any() and solution.damping_factor == 1.0


@pytest.mark.parametrize("channel", [None, 1])
def test_equations_that_rounding_breaks_are_damped_until_they_hold(channel):
    """With an eigenvalue a little below 0, in all channels or in one alone, where no factor shows it."""
    system, x, y = problem(alike=True)
    values, turn = torch.linalg.eigh(system.channels[0])
    bent = turn @ torch.diag(torch.cat([torch.tensor([-1e-3]).double(), values[1:]])) @ turn.T
    channels = bent.expand(3, -1, -1).clone() if channel is None else system.channels.clone()
    if channel is not None:
        channels[channel] = bent
    weak = 1e-9 * torch.eye(DIRECTIONS, dtype=torch.float64)
    broken = System(channels, 0.0 * system.cross, system.shared, weak, weak)
    along = turn[:, 0].expand(3, -1)
    solution = solve(broken, along, y, 1e-3, SETTINGS)
    assert torch.isfinite(solution.x).all() and torch.isfinite(solution.y).all()
    assert solution.damping_factor > 1.0 == solve(system, x, y, 1e-3, SETTINGS).damping_factor
    with pytest.raises(DanteError, match="cannot be solved"):
        nothing = System(torch.nan * channels, system.cross, system.shared, weak, weak)
        solve(nothing, x, y, 1e-3, SETTINGS)
