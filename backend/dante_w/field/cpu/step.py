"""The model on the CPU, all in numba: values for the bake, and whole steps of the fit.

A batch is cut into pieces that threads take in turn. Each piece writes its samples' gradients; then each level of a grid
is one thread's, which adds up what the samples say in their order, and takes Adam's step. Pieces and levels do not depend on how
many threads there are, so neither does a single bit of the result.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache, partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import torch

from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.adam import BETA_1, BETA_2, adam
from dante_w.field.cpu.kernels.batch import Batch, Photos, evaluate, gradients, scatter_photos
from dante_w.field.cpu.kernels.decoder import OUTPUTS, Decoder
from dante_w.field.cpu.kernels.grid import Grid, scatter
from dante_w.field.cpu.kernels.loss import Weights
from dante_w.field.gradients import Gradients

if TYPE_CHECKING:
    from dante_w.field.fields import Model
    from dante_w.field.hash_encoding import HashGrid
    from dante_w.field.optimise import LossTerms, Share
    from dante_w.rays.ray_cache import Samples

#: Samples in a piece of a batch.
PIECE = 16 * BLOCK
#: Irradiance this low counts as black, which has no tint.
DARKNESS = 1e-3
#: |w_k| counts as at most this: e^20 is 29 stops.
EXTREME_EXPOSURE = 20.0


def computes(grid: HashGrid, decoder: torch.nn.Module) -> bool:
    """Whether these kernels know such a field, where it is."""
    tables = grid.tables
    known = type(decoder) is torch.nn.Sequential
    return known and tables.device.type == "cpu" and tables.dtype == torch.float32


def decoded(
    grid: HashGrid, decoder: torch.nn.Module, points: torch.Tensor, extra: torch.Tensor | None
) -> torch.Tensor:
    """What `decoder` (N, 3) makes of encoded `points` (N, D) and further inputs `extra` (N, E), without gradients."""
    out = torch.empty(len(points), 3)
    further = np.empty((len(points), 0), np.float32) if extra is None else _array(extra)
    arguments = _array(points), further, grid_of(grid), decoder_of(decoder)
    pieces = pieces_of(len(points), PIECE)
    run(partial(evaluate, *arguments, first, end, out.numpy()) for first, end in pieces)
    return out


class FusedStep:
    """`optimise.Step` on the CPU. It writes to the parameters' own memory."""

    def __init__(
        self, model: Model, terms: LossTerms, parameters: Sequence[torch.nn.Parameter], learning_rate: float
    ) -> None:
        self._model, self._terms, self._learning_rate, self.updates = model, terms, learning_rate, 0
        chosen = {id(parameter) for parameter in parameters}
        self._states = {
            name: _State(_array(parameter), _cuts(model, name))
            for name, parameter in model.named_parameters()
            if id(parameter) in chosen
        }
        self._buffers = _Buffers(max((state.longest for state in self._states.values()), default=0))
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
        pieces = pieces_of(count, PIECE)
        decoders = decoder_of(albedo.decoder), decoder_of(light.decoder)
        sums = [_stacked(decoder, len(pieces)) for decoder in decoders]
        arguments = grid_of(albedo.grid), decoders[0], grid_of(light.grid), decoders[1], self._photos()
        weights = self._weights(batch)
        losses = run(
            partial(gradients, batch, *piece, *arguments, weights, self._rows, *(_at(own, i) for own in sums))
            for i, piece in enumerate(pieces)
        )
        told: dict[str, Callable[[int, np.ndarray], None]] = {}
        for name, own in zip(("albedo", "irradiance"), sums, strict=True):
            for part, stack in zip(_DECODER_PARTS, own, strict=True):
                told[f"{name}.decoder.{part}"] = partial(_add_sum, stack)
        told[_ALBEDO] = partial(_add_level, grid_of(albedo.grid), batch.uv, self._rows, first_rows["albedo"])
        if self._terms.photometric:
            row = first_rows["irradiance"]
            told[_LIGHT] = partial(_add_level, grid_of(light.grid), batch.position, self._rows, row)
            for name in _PHOTO_ROWS:
                told[name] = partial(_add_photos, batch.photo, self._rows, first_rows[name])
        for name, state in self._states.items():
            state.told = told.get(name)
        return math.fsum(losses), Gradients({name: state.gradient for name, state in self._states.items()})

    def update(self, rate: float, share: Share | None = None) -> None:
        """See `Step`."""
        self.updates += 1
        step = np.float32(self._learning_rate * rate / (1.0 - float(BETA_1) ** self.updates))
        root = np.float32(1.0 / math.sqrt(1.0 - float(BETA_2) ** self.updates))
        parts = [(state, part) for state in self._states.values() for part in range(len(state.parts))]
        parts.sort(key=lambda own: own[0].length(own[1]), reverse=True)  # threads take the slowest first
        tasks = [partial(state.update, part, self._buffers, step, root, share) for state, part in parts]
        if share:  # all processes in the same order
            for task in tasks:
                task()
        else:
            run(tasks)
        for state in self._states.values():
            state.told = None

    def moments(self) -> list[np.ndarray]:
        """What Adam remembers, besides the number of `updates`: the arrays themselves."""
        return [moment for state in self._states.values() for moment in state.moments]

    def _photos(self) -> Photos:
        model = self._model
        log_exposure = _array(model.log_exposure).clip(-EXTREME_EXPOSURE, EXTREME_EXPOSURE)
        return Photos(_array(model.embedding), np.exp(log_exposure), _array(model.offset))

    def _weights(self, batch: Batch) -> Weights:
        terms, each = self._terms, 1.0 / (3.0 * len(batch.uv))
        on = each if terms.photometric else 0.0
        prior = terms.prior_weight * each if len(batch.prior) else 0.0
        values = on, terms.white_light * on, terms.small_offset * on, prior, DARKNESS
        return Weights(*(np.float32(value) for value in values))


class _Buffers:
    """Room for a gradient of up to `longest` numbers, for each thread that is at one: 0 before and after."""

    def __init__(self, longest: int) -> None:
        self._longest, self._free = longest, SimpleQueue[np.ndarray]()

    @contextmanager
    def taken(self) -> Iterator[np.ndarray]:
        try:
            buffer = self._free.get_nowait()
        except Empty:
            buffer = np.zeros(self._longest, np.float32)
        yield buffer
        self._free.put(buffer)


class _State:
    """A parameter while it is fitted, in `parts` from row to row, which are the levels of a table: its value, what Adam
    remembers, and between `gradients` and `update` what the batch has `told`, which adds a part's gradient to an array.

    So a gradient is made and used up part by part, while it is in the processor's cache.
    """

    def __init__(self, value: np.ndarray, cuts: Sequence[int]) -> None:
        self._value = value
        self.moments = [np.zeros_like(value) for _ in range(2)]
        self.parts = [slice(first, end) for first, end in itertools.pairwise(cuts)]
        self.longest = max(self.length(part) for part in range(len(self.parts)))
        self.told: Callable[[int, np.ndarray], None] | None = None

    def length(self, part: int) -> int:
        """Numbers in a part."""
        return self._value[self.parts[part]].size

    def gradient(self) -> np.ndarray:
        whole = np.zeros_like(self._value)
        for part, own in enumerate(self.parts):
            if self.told:
                self.told(part, whole[own])
        return whole

    def update(
        self, part: int, buffers: _Buffers, step: np.float32, root: np.float32, share: Share | None
    ) -> None:
        values = [array[self.parts[part]] for array in (self._value, *self.moments)]
        with buffers.taken() as buffer:
            gradient = buffer[: values[0].size].reshape(values[0].shape)
            if self.told:
                self.told(part, gradient)
            if share:
                share(torch.from_numpy(gradient))
            adam(*(array.reshape(-1) for array in (*values, gradient)), step, root)


def _cuts(model: Model, name: str) -> list[int]:
    """The rows between which a parameter's parts are."""
    if name in (_ALBEDO, _LIGHT):
        return grid_of(getattr(model, name.split(".")[0]).grid).offsets.tolist()
    return [0, len(model.get_parameter(name))]


def _add_level(
    grid: Grid, points: np.ndarray, rows: np.ndarray, first_row: int, level: int, gradient: np.ndarray
) -> None:
    """What rows, from the first of the grid on, say of the entries of one level."""
    row = first_row + level * gradient.shape[1]
    scatter(points, grid.resolutions[level], rows, row, gradient)


def _add_photos(photo: np.ndarray, rows: np.ndarray, first_row: int, _: int, gradient: np.ndarray) -> None:
    scatter_photos(photo, rows, first_row, gradient)


def _add_sum(stack: np.ndarray, _: int, gradient: np.ndarray) -> None:
    """What the pieces of a batch say, without the rows that a parameter lacks."""
    gradient += stack.sum(0)[: len(gradient)]


_ALBEDO, _LIGHT = "albedo.grid.tables", "irradiance.grid.tables"
_DECODER_PARTS = ("0.weight", "0.bias", "2.weight", "2.bias")
_PHOTO_ROWS = ("embedding", "log_exposure", "offset")
_ROWS = ("albedo", "irradiance", *_PHOTO_ROWS)


def _batch(samples: Samples) -> Batch:
    return Batch(
        samples.photo.numpy(),
        _array(samples.uv),
        _array(samples.position),
        _array(samples.colour),
        np.empty((0, 4), np.float32) if samples.prior is None else _array(samples.prior),
        np.ones(len(samples.uv), np.float32) if samples.weight is None else _array(samples.weight),
    )


def grid_of(grid: HashGrid) -> Grid:
    spec = grid.spec
    offsets = np.cumsum([0, *spec.entries])
    return Grid(_array(grid.tables), np.array(spec.resolutions, np.float32), offsets)


def decoder_of(decoder: torch.nn.Module) -> Decoder:
    """The layers as the kernels take them: the second one is a copy, with a row of zeros added."""
    w1, b1, w2, b2 = (_array(parameter) for parameter in decoder.parameters())
    w2, b2 = (np.concatenate([part, np.zeros_like(part[: OUTPUTS - len(part)])]) for part in (w2, b2))
    return Decoder(w1, b1, w2, b2)


def _stacked(decoder: Decoder, count: int) -> Decoder:
    return Decoder(*(np.zeros((count, *part.shape), np.float32) for part in decoder))


def _at(stacked: Decoder, index: int) -> Decoder:
    return Decoder(*(part[index] for part in stacked))


def _array(tensor: torch.Tensor) -> np.ndarray:
    """The tensor's own memory wherever possible: float32, row-major."""
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


@lru_cache(maxsize=1)
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(numba.get_num_threads(), "fit")


def run(tasks: Iterable[Callable[[], Any]]) -> list[Any]:
    """Results of tasks that free the GIL, which threads take in turn."""
    return list(_threads().map(lambda task: task(), tasks))


def pieces_of(length: int, size: int) -> list[tuple[int, int]]:
    return [(first, min(first + size, length)) for first in range(0, length, size)]
