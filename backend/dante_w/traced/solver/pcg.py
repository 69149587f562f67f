"""Linear equations in three channels that are nearly alike, by conjugate gradients.

What photos say of light they say of each channel alone, and of all three about as strongly; a prior ties the channels together,
much more weakly in brightness than in tint. So brightness and two tints are nearly apart, and equations that take each
channel for the mean of the three precondition the true ones: two Cholesky factors of a third of the length, in place of one of
the whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from dante_w.contract.errors import DanteError

#: Brightness and two tints, orthonormal, as weights of the channels.
OPPONENT = torch.tensor(
    [[3**-0.5] * 3, [2**-0.5, -(2**-0.5), 0.0], [6**-0.5, 6**-0.5, -2 * 6**-0.5]], dtype=torch.float64
)
#: What is left of the residual at the end, in the preconditioner's norm; a step of many needs no more.
TOLERANCE = 1e-3
#: Iterations at most; the solution is on its way downhill all the time.
ITERATIONS = 200
#: What the damping is multiplied with where that much of it gives no solution.
HARDER = (1e3, 1e6)


@dataclass(frozen=True)
class System:
    """Symmetric equations for x (3, N) of the channels and y (R,) that they share, float64 tensors: `own` (3, N, N) of each
    channel, `cross` (3, R, N) of y with x, `shared` (R, R) of y. The N are lights of D directions each; a
    prior adds to all lights alike `brightness` (D, D), for what channels have in common, and `tint` (D, D), for the rest."""

    own: torch.Tensor
    cross: torch.Tensor
    shared: torch.Tensor
    brightness: torch.Tensor
    tint: torch.Tensor

    def times(self, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        lights = x.reshape(3, -1, len(self.tint))
        mean = lights.mean(dim=0)
        prior = mean @ self.brightness + (lights - mean) @ self.tint
        along = torch.stack([own @ part for own, part in zip(self.own, x, strict=True)])
        along += prior.reshape(x.shape) + torch.einsum("crn,r->cn", self.cross, y)
        return along, torch.einsum("crn,cn->r", self.cross, x) + self.shared @ y

    def damped(self, relative: float, absolute: float) -> System:
        """With more on the diagonal."""
        lights = self.own.shape[1] // len(self.tint)
        prior = ((self.brightness + 2.0 * self.tint).diagonal() / 3.0).repeat(lights)
        own, shared = self.own.clone(), self.shared.clone()
        for part, further in ((own, prior), (shared, 0.0)):
            diagonal = part.diagonal(dim1=-2, dim2=-1)
            diagonal += relative * (diagonal + further) + absolute
        return System(own, self.cross, shared, self.brightness, self.tint)


def solve(
    system: System, x: torch.Tensor, y: torch.Tensor, damping: float
) -> tuple[torch.Tensor, torch.Tensor, float]:
    """What solves the damped equations with right-hand sides x (3, N) and y (R,), and how much harder they had to be damped
    until there was such a thing: rounding may leave equations that have none.

    Raises:
        DanteError: there is none.
    """
    for further in (1.0, *HARDER):
        found = _descend(system.damped(0.01 * damping * further, 1e-8 * further), x, y)
        if found is not None:
            return *found, further
    raise DanteError("The photos' light cannot be solved for; take --irradiance field.")


def _descend(system: System, x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor] | None:
    """Conjugate gradients from 0 (Hestenes and Stiefel, 1952); None if the equations are not positive definite."""
    precondition = _preconditioner(system)
    if precondition is None:
        return None
    found = torch.zeros_like(x), torch.zeros_like(y)
    left, along = (x, y), precondition(x, y)
    size = first = _dot(left, along)
    for _ in range(ITERATIONS):
        if not math.isfinite(size):
            return None
        if size <= TOLERANCE**2 * first:
            break
        answer = system.times(*along)
        curvature = _dot(along, answer)
        if not curvature > 0.0:
            return None
        found = _plus(found, size / curvature, along)
        left = _plus(left, -size / curvature, answer)
        down = precondition(*left)
        before, size = size, _dot(left, down)
        along = _plus(down, size / before, along)
    return found


def _preconditioner(
    system: System,
) -> Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, torch.Tensor]] | None:
    """What solves the equations if all channels are as their mean; None if that has no solution."""
    size, mean = system.own.shape[1], system.own.mean(dim=0)
    whole = torch.empty((size + len(system.shared),) * 2, dtype=torch.float64)
    whole[:size, :size] = _with(mean, system.brightness)
    whole[size:, :size] = torch.einsum("c,crn->rn", OPPONENT[0], system.cross)
    whole[size:, size:] = system.shared
    brightness, failed = torch.linalg.cholesky_ex(whole)  # of which the lower triangle is all that is read
    tints, also = torch.linalg.cholesky_ex(_with(mean, system.tint))
    if failed or also:
        return None
    brightness, tints = brightness.float(), tints.float()  # rounding costs no more than an iteration

    def solved(x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        apart = OPPONENT @ x
        first, others = torch.cat([apart[0], y])[:, None].float(), apart[1:].T.float()
        common = torch.cholesky_solve(first, brightness)[:, 0].double()
        apart = torch.stack([common[:size], *torch.cholesky_solve(others, tints).T.double()])
        return OPPONENT.T @ apart, common[size:]

    return solved


def _with(own: torch.Tensor, prior: torch.Tensor) -> torch.Tensor:
    """(N, N), and (D, D) added to each light's own."""
    directions = len(prior)
    found = own.clone()
    lights = found.reshape(-1, directions, len(own) // directions, directions).diagonal(dim1=0, dim2=2)
    lights += prior[..., None]
    return found


_Pair = tuple[torch.Tensor, torch.Tensor]


def _dot(one: _Pair, other: _Pair) -> float:
    return float((one[0] * other[0]).sum() + one[1] @ other[1])


def _plus(one: _Pair, scale: float, other: _Pair) -> _Pair:
    return one[0] + scale * other[0], one[1] + scale * other[1]
