"""The normal equations solved by preconditioned conjugate gradients.

Photos constrain light in each channel alone, and all three channels about equally. The light prior ties the channels
together, much more weakly in brightness than in colour. So brightness and two colour differences are nearly independent,
and equations that take each channel for the mean of the three are a good preconditioner: two Cholesky factors of a third of the
size, instead of one of all unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from dante_w.contract.errors import DanteError

#: Brightness and two colour differences, orthonormal, as weights of the channels.
OPPONENT = torch.tensor(
    [[3**-0.5] * 3, [2**-0.5, -(2**-0.5), 0.0], [6**-0.5, 6**-0.5, -2 * 6**-0.5]], dtype=torch.float64
)


@dataclass(frozen=True)
class PcgSettings:
    """When iterations end, and how equations are damped."""

    #: Residual at the end over that at the start, in the preconditioner's norm. One step of many needs no less.
    tolerance: float = 1e-3
    #: Iterations at most: each of them lowers the cost, so the solution may be used at any time.
    iterations: int = 200
    #: Part of the diagonal that a damping of 1 adds to it.
    relative_damping: float = 0.01
    #: Added to the diagonal in any case, so that unknowns without observations stay where they are.
    absolute_damping: float = 1e-8
    #: What both are multiplied with, one after another, where rounding leaves equations without a solution.
    retries: tuple[float, ...] = (1e3, 1e6)


@dataclass(frozen=True)
class System:
    """Symmetric equations for x (3, N) of the channels and y (R,) that the channels share, float64.

    The N unknowns of a channel are J lights of D directions each. The light prior adds the same to every light.

    Attributes:
        channels: (3, N, N) of x, each channel's own.
        cross: (3, R, N) of y with x.
        shared: (R, R) of y.
        brightness: (D, D) precision of the mean over the channels.
        colour: (D, D) precision of each channel's difference from the mean.
    """

    channels: torch.Tensor
    cross: torch.Tensor
    shared: torch.Tensor
    brightness: torch.Tensor
    colour: torch.Tensor

    def times(self, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The matrix times x (3, N) and y (R,)."""
        lights = x.reshape(3, -1, len(self.colour))
        mean = lights.mean(dim=0)
        prior = mean @ self.brightness + (lights - mean) @ self.colour
        product = torch.stack([matrix @ part for matrix, part in zip(self.channels, x, strict=True)])
        product += prior.reshape(x.shape) + torch.einsum("crn,r->cn", self.cross, y)
        return product, torch.einsum("crn,cn->r", self.cross, x) + self.shared @ y

    def damped(self, relative: float, absolute: float) -> System:
        """The same with `relative` of the diagonal, and `absolute`, added to the diagonal."""
        lights = self.channels.shape[1] // len(self.colour)
        prior = ((self.brightness + 2.0 * self.colour).diagonal() / 3.0).repeat(lights)
        channels, shared = self.channels.clone(), self.shared.clone()
        for matrix, further in ((channels, prior), (shared, 0.0)):
            diagonal = matrix.diagonal(dim1=-2, dim2=-1)
            diagonal += relative * (diagonal + further) + absolute
        return System(channels, self.cross, shared, self.brightness, self.colour)


@dataclass(frozen=True)
class Solution:
    """x (3, N) and y (R,) of a `System`, and what the damping had to be multiplied with; 1 if it was enough."""

    x: torch.Tensor
    y: torch.Tensor
    damping_factor: float


def solve(
    system: System, x: torch.Tensor, y: torch.Tensor, damping: float, settings: PcgSettings
) -> Solution:
    """Solve the damped equations with the right-hand sides x (3, N) and y (R,), with more damping where they have no solution.

    Raises:
        DanteError: there is no solution with any damping.
    """
    for factor in (1.0, *settings.retries):
        relative = settings.relative_damping * damping * factor
        solution = _descend(system.damped(relative, settings.absolute_damping * factor), x, y, settings)
        if solution is not None:
            return Solution(*solution, factor)
    raise DanteError("The photos' light cannot be solved for; take --irradiance field.")


def _descend(
    system: System, x: torch.Tensor, y: torch.Tensor, settings: PcgSettings
) -> tuple[torch.Tensor, torch.Tensor] | None:
    """Conjugate gradients from 0 (Hestenes and Stiefel, 1952); None if the equations are not positive definite."""
    precondition = _preconditioner(system)
    if precondition is None:
        return None
    solution = torch.zeros_like(x), torch.zeros_like(y)
    residual, direction = (x, y), precondition(x, y)
    size = first = _dot(residual, direction)
    for _ in range(settings.iterations):
        if not math.isfinite(size):
            return None
        if size <= settings.tolerance**2 * first:
            break
        product = system.times(*direction)
        curvature = _dot(direction, product)
        if not curvature > 0.0:
            return None
        solution = _plus(solution, size / curvature, direction)
        residual = _plus(residual, -size / curvature, product)
        gradient = precondition(*residual)
        before, size = size, _dot(residual, gradient)
        direction = _plus(gradient, size / before, direction)
    return solution


def _preconditioner(
    system: System,
) -> Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, torch.Tensor]] | None:
    """What solves the equations if all channels are as their mean; None if that has no solution."""
    size, mean = system.channels.shape[1], system.channels.mean(dim=0)
    whole = torch.empty((size + len(system.shared),) * 2, dtype=torch.float64)
    whole[:size, :size] = _with_prior(mean, system.brightness)
    whole[size:, :size] = torch.einsum("c,crn->rn", OPPONENT[0], system.cross)
    whole[size:, size:] = system.shared
    brightness, failed = torch.linalg.cholesky_ex(whole)  # of which the lower triangle is all that is read
    colour, also_failed = torch.linalg.cholesky_ex(_with_prior(mean, system.colour))
    if failed or also_failed:
        return None
    brightness, colour = brightness.float(), colour.float()  # rounding costs no more than an iteration

    def solved(x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        opponent = OPPONENT @ x
        first, others = torch.cat([opponent[0], y])[:, None].float(), opponent[1:].T.float()
        common = torch.cholesky_solve(first, brightness)[:, 0].double()
        opponent = torch.stack([common[:size], *torch.cholesky_solve(others, colour).T.double()])
        return OPPONENT.T @ opponent, common[size:]

    return solved


def _with_prior(matrix: torch.Tensor, prior: torch.Tensor) -> torch.Tensor:
    """(N, N) with the prior (D, D) added to each light's block."""
    directions = len(prior)
    whole = matrix.clone()
    blocks = whole.reshape(-1, directions, len(matrix) // directions, directions).diagonal(dim1=0, dim2=2)
    blocks += prior[..., None]
    return whole


_Pair = tuple[torch.Tensor, torch.Tensor]


def _dot(one: _Pair, other: _Pair) -> float:
    return float((one[0] * other[0]).sum() + one[1] @ other[1])


def _plus(one: _Pair, scale: float, other: _Pair) -> _Pair:
    return one[0] + scale * other[0], one[1] + scale * other[1]
