"""The model on the CPU, all in numba: values for the bake, and whole steps of the fit.

A batch is cut into pieces that threads take in turn. Each piece writes its samples' gradients; then each level of a grid
is one thread's, which adds up what the samples say in their order. Pieces do not depend on how many threads there are,
so neither does a single bit of the result.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import torch

from dante_w.model.kernels import BLOCK
from dante_w.model.kernels.adam import BETA_1, BETA_2, LINE, adam
from dante_w.model.kernels.batch import Batch, Photos, evaluate, gradients, scatter_photos
from dante_w.model.kernels.decoder import OUTPUTS, Decoder
from dante_w.model.kernels.grid import Grid, scatter
from dante_w.model.kernels.loss import Weights
from dante_w.model.pyramid import LevelSum

if TYPE_CHECKING:
    from dante_w.model.fields import Model
    from dante_w.model.hash_encoding import HashGrid
    from dante_w.model.optimise import LossTerms
    from dante_w.rays.ray_cache import Samples

#: Samples in a piece of a batch, and numbers in a piece of a table.
PIECE, TABLE_PIECE = 8 * BLOCK, 1 << 18
#: Irradiance this low counts as black, which has no tint.
DARKNESS = 1e-3
#: |w_k| counts as at most this: e^20 is 29 stops.
EXTREME_EXPOSURE = 20.0


def computes(grid: HashGrid, decoder: torch.nn.Module) -> bool:
    """Whether these kernels know such a field, where it is."""
    tables = grid.tables
    known = type(decoder) in (torch.nn.Sequential, LevelSum)
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
        self._state = {
            name: _Moments(_array(parameter))
            for name, parameter in model.named_parameters()
            if id(parameter) in chosen
        }
        self._rows = np.empty((0, 0, 0), np.float32)

    def gradients(self, samples: Samples) -> tuple[float, dict[str, np.ndarray]]:
        """The batch's loss, and its gradients by the parameters' names; they are valid until `update`, and asked for
        once before it."""
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
        for name, own in zip(("albedo", "irradiance"), sums, strict=True):
            for part, stack in zip(_DECODER_PARTS, own, strict=True):
                if f"{name}.decoder.{part}" in self._state:
                    gradient = self._state[f"{name}.decoder.{part}"].gradient
                    gradient[:] = stack.sum(0)[: len(gradient)]
        run(self._scatters(batch, first_rows))
        return math.fsum(losses), {name: state.gradient for name, state in self._state.items()}

    def update(self, rate: float, share: Callable[[torch.Tensor], None] = lambda _: None) -> None:
        """Take an Adam step along the gradients, with the learning rate times `rate`; see `Step`."""
        for state in self._state.values():
            share(torch.from_numpy(state.gradient))
        self.updates += 1
        step = np.float32(self._learning_rate * rate / (1.0 - float(BETA_1) ** self.updates))
        root = np.float32(1.0 / math.sqrt(1.0 - float(BETA_2) ** self.updates))
        run(partial(adam, *piece, step, root) for state in self._state.values() for piece in state.pieces)

    def moments(self) -> list[np.ndarray]:
        """What Adam remembers, besides the number of `updates`: the arrays themselves."""
        return [moment for state in self._state.values() for moment in state.moments]

    def _scatters(self, batch: Batch, first_rows: dict[str, int]) -> Iterable[Callable[[], None]]:
        """Tasks that add up what the samples say, each for numbers of its own; the slowest first."""
        light = self._terms.photometric
        for name, points in (("irradiance", batch.position), ("albedo", batch.uv)):
            state = self._state.get(f"{name}.grid.tables")
            if state is None or (name == "irradiance" and not light):
                continue
            grid = grid_of(getattr(self._model, name).grid)
            features = grid.tables.shape[1]
            for level in reversed(range(len(grid.resolutions))):
                row = first_rows[name] + level * features
                entries = slice(grid.offsets[level], grid.offsets[level + 1])
                settings = grid.resolutions[level], grid.shift
                yield partial(scatter, points, *settings, self._rows, row, state.gradient[entries])
        for name in _PHOTO_ROWS:
            if name in self._state and light:
                yield partial(
                    scatter_photos, batch.photo, self._rows, first_rows[name], self._state[name].gradient
                )

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


class _Moments:
    """A parameter's `value`, the gradient added up so far, and what Adam remembers; `pieces` are the arguments of `adam`
    for all of it."""

    def __init__(self, value: np.ndarray) -> None:
        self.gradient, mean, square = (np.zeros_like(value) for _ in range(3))
        self.moments = [mean, square]
        flat = [array.reshape(-1) for array in (value, mean, square, self.gradient)]
        whole = value.size - value.size % LINE
        cuts = [*pieces_of(whole, TABLE_PIECE), (whole, value.size)]
        self.pieces = [
            [array[first:end].reshape(-1, LINE if end <= whole else end - first) for array in flat]
            for first, end in cuts
            if end > first
        ]


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
    shift = np.float32(0.5 if spec.centred else 0.0)
    return Grid(_array(grid.tables), np.array(spec.resolutions, np.float32), offsets, shift)


def decoder_of(decoder: torch.nn.Module) -> Decoder:
    """The layers as the kernels take them: the second one is a copy, with a row of zeros added."""
    if isinstance(decoder, torch.nn.Sequential):
        w1, b1, w2, b2 = (_array(parameter) for parameter in decoder.parameters())
        w2, b2 = (np.concatenate([part, np.zeros_like(part[: OUTPUTS - len(part)])]) for part in (w2, b2))
        return Decoder(w1, b1, w2, b2)
    shapes = (0, 0), (0,), (OUTPUTS, 0), (OUTPUTS,)
    return Decoder(*(np.zeros(shape, np.float32) for shape in shapes))


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
