"""The model on the CPU, all in numba: values without gradients, and whole steps of the fit.

A batch is cut into pieces that threads take in turn. Each piece writes its samples' gradients; then each level of a grid
belongs to one thread, which adds up the gradients of its samples in their order and takes Adam's step. Pieces and levels do
not depend on how many threads there are, so neither does a single bit of the result.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any

import numba
import numpy as np
import torch

from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.adam import BETA_1, BETA_2
from dante_w.field.cpu.kernels.batch import Batch, Photos, evaluate, gradients, scatter_photos
from dante_w.field.cpu.kernels.decoder import OUTPUTS, Decoder
from dante_w.field.cpu.kernels.grid import Grid, scatter
from dante_w.field.cpu.kernels.loss import Weights
from dante_w.field.cpu.parameter_state import AddGradient, Buffers, ParameterState
from dante_w.field.fields import EXTREME_EXPOSURE, FieldModel
from dante_w.field.gradients import Gradients
from dante_w.field.hash_encoding import HashGrid
from dante_w.field.step import AllReduce
from dante_w.field.terms import DARKNESS, LossTerms
from dante_w.rays.ray_cache import Samples

#: Samples in a piece of a batch.
PIECE = 16 * BLOCK
_ALBEDO, _LIGHT = "albedo.grid.tables", "irradiance.grid.tables"
_DECODER_PARTS = ("0.weight", "0.bias", "2.weight", "2.bias")
_PHOTO_ROWS = ("embedding", "log_exposure", "offset")
_ROWS = ("albedo", "irradiance", *_PHOTO_ROWS)


def supports(grid: HashGrid, decoder: torch.nn.Module) -> bool:
    """Whether these kernels compute such a field, where it is."""
    tables = grid.tables
    known = type(decoder) is torch.nn.Sequential
    return known and tables.device.type == "cpu" and tables.dtype == torch.float32


def decode_points(
    grid: HashGrid, decoder: torch.nn.Module, points: torch.Tensor, embedding: torch.Tensor | None
) -> torch.Tensor:
    """What `decoder` gives (N, 3) for encoded `points` (N, D) and embeddings (N, E), without gradients."""
    out = torch.empty(len(points), 3)
    extra = np.empty((len(points), 0), np.float32) if embedding is None else _array(embedding)
    arguments = _array(points), extra, _kernel_grid(grid), _kernel_decoder(decoder)
    _run(partial(evaluate, *arguments, *piece, out.numpy()) for piece in _pieces(len(points)))
    return out


class CpuStep:
    """`step.Step` on the CPU. It writes to the parameters' own memory."""

    def __init__(
        self,
        model: FieldModel,
        terms: LossTerms,
        parameters: Sequence[torch.nn.Parameter],
        learning_rate: float,
    ) -> None:
        self._model, self._terms, self._learning_rate, self.updates = model, terms, learning_rate, 0
        chosen = {id(parameter) for parameter in parameters}
        self._states = {
            name: ParameterState(_array(parameter), _cuts(model, name))
            for name, parameter in model.named_parameters()
            if id(parameter) in chosen
        }
        self._buffers = Buffers(max((state.longest for state in self._states.values()), default=0))
        self._rows = np.empty((0, 0, 0), np.float32)

    def gradients(self, samples: Samples) -> tuple[float, Gradients[np.ndarray]]:
        """See `Step`; a table's gradient is made when it is asked for."""
        model, batch = self._model, _batch(samples)
        count = len(batch.uv)
        albedo, light = model.albedo, model.irradiance
        widths = [albedo.grid.spec.width, light.grid.spec.width, model.spec.embedding, 3, 3]
        first_rows = dict(zip(_ROWS, itertools.accumulate([0, *widths]), strict=False))
        if len(self._rows) * BLOCK < count:
            self._rows = np.empty((-(-count // BLOCK), sum(widths), BLOCK), np.float32)
        pieces = _pieces(count)
        decoders = _kernel_decoder(albedo.decoder), _kernel_decoder(light.decoder)
        sums = [_stacked(decoder, len(pieces)) for decoder in decoders]
        fields = _kernel_grid(albedo.grid), decoders[0], _kernel_grid(light.grid), decoders[1]
        arguments = *fields, self._photos(), self._weights(batch), self._rows
        losses = _run(
            partial(gradients, batch, *piece, *arguments, *(_at(stack, number) for stack in sums))
            for number, piece in enumerate(pieces)
        )
        sources: dict[str, AddGradient] = {}
        for name, stacks in zip(("albedo", "irradiance"), sums, strict=True):
            for part, stack in zip(_DECODER_PARTS, stacks, strict=True):
                sources[f"{name}.decoder.{part}"] = partial(_add_sum, stack)
        sources[_ALBEDO] = partial(_add_level, fields[0], batch.uv, self._rows, first_rows["albedo"])
        if self._terms.photometric:
            row = first_rows["irradiance"]
            sources[_LIGHT] = partial(_add_level, fields[2], batch.position, self._rows, row)
            for name in _PHOTO_ROWS:
                sources[name] = partial(_add_photos, batch.photo, self._rows, first_rows[name])
        for name, state in self._states.items():
            state.add_gradient = sources.get(name)
        return math.fsum(losses), Gradients({name: state.gradient for name, state in self._states.items()})

    def update(self, rate: float, all_reduce: AllReduce | None = None) -> None:
        """See `Step`."""
        self.updates += 1
        step = np.float32(self._learning_rate * rate / (1.0 - float(BETA_1) ** self.updates))
        root = np.float32(1.0 / math.sqrt(1.0 - float(BETA_2) ** self.updates))
        parts = [(state, part) for state in self._states.values() for part in range(len(state.parts))]
        parts.sort(key=lambda pair: pair[0].length(pair[1]), reverse=True)  # threads take the slowest first
        tasks = [partial(state.update, part, self._buffers, step, root, all_reduce) for state, part in parts]
        if all_reduce:  # all processes in the same order
            for task in tasks:
                task()
        else:
            _run(tasks)
        for state in self._states.values():
            state.add_gradient = None

    def moments(self) -> list[np.ndarray]:
        """What Adam remembers, besides the number of `updates`: the arrays themselves."""
        return [moment for state in self._states.values() for moment in state.moments]

    def _photos(self) -> Photos:
        model = self._model
        log_exposure = _array(model.log_exposure).clip(-EXTREME_EXPOSURE, EXTREME_EXPOSURE)
        return Photos(_array(model.embedding), np.exp(log_exposure), _array(model.offset))

    def _weights(self, batch: Batch) -> Weights:
        terms, each = self._terms, 1.0 / (3.0 * len(batch.uv))
        photometric = each if terms.photometric else 0.0
        prior = terms.prior_weight * each if len(batch.prior) else 0.0
        extra = terms.white_light * photometric, terms.small_offset * photometric
        return Weights(*(np.float32(value) for value in (photometric, *extra, prior, DARKNESS)))


def _cuts(model: FieldModel, name: str) -> list[int]:
    """The rows between which a parameter's parts are."""
    if name in (_ALBEDO, _LIGHT):
        return _kernel_grid(getattr(model, name.split(".")[0]).grid).offsets.tolist()
    return [0, len(model.get_parameter(name))]


def _add_level(
    grid: Grid, points: np.ndarray, rows: np.ndarray, first_row: int, level: int, gradient: np.ndarray
) -> None:
    """Add the gradients of one level's entries: `rows` has them by sample, the grid's from `first_row` on."""
    scatter(points, grid.resolutions[level], rows, first_row + level * gradient.shape[1], gradient)


def _add_photos(photo: np.ndarray, rows: np.ndarray, first_row: int, _: int, gradient: np.ndarray) -> None:
    scatter_photos(photo, rows, first_row, gradient)


def _add_sum(stack: np.ndarray, _: int, gradient: np.ndarray) -> None:
    """Add the sums of a batch's pieces, without the rows that the parameter lacks."""
    gradient += stack.sum(0)[: len(gradient)]


def _batch(samples: Samples) -> Batch:
    return Batch(
        samples.photo.numpy(),
        _array(samples.uv),
        _array(samples.position),
        _array(samples.colour),
        np.empty((0, 4), np.float32) if samples.prior is None else _array(samples.prior),
        np.ones(len(samples.uv), np.float32) if samples.weight is None else _array(samples.weight),
    )


def _kernel_grid(grid: HashGrid) -> Grid:
    offsets = np.cumsum([0, *grid.spec.entries])
    return Grid(_array(grid.tables), np.array(grid.spec.resolutions, np.float32), offsets)


def _kernel_decoder(decoder: torch.nn.Module) -> Decoder:
    """The layers as the kernels take them: the second one is a copy, with a row of zeros added."""
    w1, b1, w2, b2 = (_array(parameter) for parameter in decoder.parameters())
    w2, b2 = (np.concatenate([part, np.zeros_like(part[: OUTPUTS - len(part)])]) for part in (w2, b2))
    return Decoder(w1, b1, w2, b2)


def _stacked(decoder: Decoder, count: int) -> Decoder:
    return Decoder(*(np.zeros((count, *part.shape), np.float32) for part in decoder))


def _at(stack: Decoder, number: int) -> Decoder:
    return Decoder(*(part[number] for part in stack))


def _array(tensor: torch.Tensor) -> np.ndarray:
    """The tensor's own memory wherever possible: float32, row-major."""
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


@lru_cache(maxsize=1)
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(numba.get_num_threads(), "fit")


def _run(tasks: Iterable[Callable[[], Any]]) -> list[Any]:
    """Results of tasks that free the GIL, which threads take in turn."""
    return list(_threads().map(lambda task: task(), tasks))


def _pieces(length: int) -> list[tuple[int, int]]:
    """(first, end) of each piece of a batch of `length` samples."""
    return [(first, min(first + PIECE, length)) for first in range(0, length, PIECE)]
