"""Steps of the fit on CUDA: encodings and their Adam in Triton, decoders and loss in torch. Experimental, see `cuda`.

The tables hold nearly all of the model's numbers. Their gradients never exist all at once: those of a few levels are added
up in one buffer, which fits the GPU's cache, and Adam takes them from there. Moments are bfloat16, rounded at random.
So a number of a table takes 8 bytes, its part of the buffer aside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import torch

from dante_w.field.cuda import grid as cuda_grid
from dante_w.field.cuda.grid import LAUNCH, AdamStep, Launch
from dante_w.field.fields import FieldModel
from dante_w.field.gradients import Gradients
from dante_w.field.hash_encoding import HashGrid
from dante_w.field.loss import model_loss
from dante_w.field.step import AllReduce
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import Samples

BETA_1, BETA_2 = 0.9, 0.999
_ALBEDO, _LIGHT = "albedo.grid.tables", "irradiance.grid.tables"


class CudaStep:
    """`step.Step` on CUDA. An entry of a table whose gradient is 0 stays as it is, moments and all, as in `CpuStep`;
    all other parameters move by torch's Adam. Sums are made in no fixed order, so runs differ in the last bits."""

    def __init__(
        self,
        model: FieldModel,
        terms: LossTerms,
        parameters: Sequence[torch.nn.Parameter],
        learning_rate: float,
        launch: Launch = LAUNCH,
    ) -> None:
        self._model, self._terms, self._learning_rate, self._updates = model, terms, learning_rate, 0
        chosen = {id(parameter) for parameter in parameters}
        grids = {_ALBEDO: model.albedo.grid, _LIGHT: model.irradiance.grid}
        self._tables = {
            name: _Table(grid, launch) for name, grid in grids.items() if id(grid.tables) in chosen
        }
        self._others = {
            name: p for name, p in model.named_parameters() if id(p) in chosen and name not in grids
        }
        self._optimiser = torch.optim.Adam(self._others.values(), lr=learning_rate, eps=1e-15, fused=True)
        longest = max((table.longest for table in self._tables.values()), default=0)
        self._buffer = torch.zeros(longest, device=model.offset.device)

    def gradients(self, samples: Samples) -> tuple[torch.Tensor, Mapping[str, torch.Tensor]]:
        """See `Step`; a table's gradient is made when it is asked for, and parameters that the loss does not depend on
        are left out."""
        with torch.enable_grad():
            loss = model_loss(_Encoded(self._model, self._tables), samples, self._terms)
        leaves = [table.encoded for table in self._tables.values() if table.encoded is not None]
        others = list(self._others.values())
        gradients = list(torch.autograd.grad(loss, [*leaves, *others], allow_unused=True))
        for table in self._tables.values():
            table.upstream = None if table.encoded is None else gradients.pop(0)
            table.encoded = None
        for parameter, gradient in zip(others, gradients, strict=True):
            parameter.grad = gradient
        makers: dict[str, Callable[[], torch.Tensor]] = {
            name: table.gradient for name, table in self._tables.items() if table.upstream is not None
        }
        makers |= {name: partial(_gradient, p) for name, p in self._others.items() if p.grad is not None}
        return loss.detach(), Gradients(makers)

    def update(self, rate: float, all_reduce: AllReduce | None = None) -> None:
        """See `Step`."""
        self._updates += 1
        size = self._learning_rate * rate
        corrections = 1.0 - BETA_1**self._updates, 1.0 - BETA_2**self._updates
        step = AdamStep(size / corrections[0], 1.0 / math.sqrt(corrections[1]), self._updates)
        for table in self._tables.values():
            table.update(step, self._buffer, all_reduce)
        for parameter in self._others.values():
            if all_reduce and parameter.grad is not None:
                all_reduce(parameter.grad)
        for group in self._optimiser.param_groups:
            group["lr"] = size
        self._optimiser.step()
        self._optimiser.zero_grad(set_to_none=True)


class _Table:
    """A grid's table while it is fitted: its value, Adam's moments, and what its gradient is made from.

    Between `gradients` and `update`: `points` (N, D) that were encoded and `upstream`, the loss's gradient with respect to the
    encoded points (N, L F); None where the loss does not depend on them.
    """

    def __init__(self, grid: HashGrid, launch: Launch) -> None:
        self.spec, self.value, self._launch = grid.spec, grid.tables.detach().view(-1), launch
        self._mean, self._square = (torch.zeros_like(self.value, dtype=torch.bfloat16) for _ in range(2))
        self._groups = cuda_grid.level_groups(self.spec)
        self.longest = max(group.entries for group in self._groups) * self.spec.features
        self.points: torch.Tensor | None = None
        self.encoded: torch.Tensor | None = None
        self.upstream: torch.Tensor | None = None

    def encode(self, points: torch.Tensor) -> torch.Tensor:
        """The encoded points, as a leaf that gradients stop at."""
        self.points = points.float().contiguous()
        encoded = cuda_grid.encode(self.points, self.value, self.spec, self._launch)
        self.encoded = encoded.requires_grad_()
        return self.encoded

    def update(self, step: AdamStep, buffer: torch.Tensor, all_reduce: AllReduce | None) -> None:
        """Adam's step, group by group; `buffer` is 0 before and after."""
        if self.points is None or self.upstream is None:
            return
        upstream = self.upstream.contiguous()
        for group in self._groups:
            first, count = group.start * self.spec.features, group.entries * self.spec.features
            gradient, part = buffer[:count], slice(first, first + count)
            cuda_grid.scatter(self.points, upstream, self.spec, group, gradient, self._launch)
            if all_reduce:
                all_reduce(gradient)
            moments = self._mean[part], self._square[part]
            cuda_grid.adam(self.value[part], *moments, gradient, step, self._launch)
        self.points = self.upstream = None

    def gradient(self) -> torch.Tensor:
        """All of the gradient (entries, F)."""
        whole = torch.zeros_like(self.value)
        assert self.points is not None and self.upstream is not None
        upstream = self.upstream.contiguous()
        for group in self._groups:
            rest = whole[group.start * self.spec.features :]
            cuda_grid.scatter(self.points, upstream, self.spec, group, rest, self._launch)
        return whole.view(-1, self.spec.features)


class _Encoded:
    """The model as `model_loss` takes it, with encodings that are leaves."""

    def __init__(self, model: FieldModel, tables: Mapping[str, _Table]) -> None:
        self.offset: torch.Tensor = model.offset
        self.expose = model.expose
        self._model, self._tables = model, tables

    def albedo(self, uv: torch.Tensor) -> torch.Tensor:
        return self._model.albedo.decode(self._encode(_ALBEDO, self._model.albedo.grid, uv))

    def light(self, position: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
        encoded = self._encode(_LIGHT, self._model.irradiance.grid, position)
        return self._model.irradiance.decode(encoded, self._model.embedding[photo])

    def _encode(self, name: str, grid: HashGrid, points: torch.Tensor) -> torch.Tensor:
        if name in self._tables:
            return self._tables[name].encode(points)
        return cuda_grid.encode(points, grid.tables, grid.spec)


def _gradient(parameter: torch.nn.Parameter) -> torch.Tensor:
    assert parameter.grad is not None
    return parameter.grad
