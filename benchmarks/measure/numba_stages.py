"""The parts of a step of the fit by the product's kernels for the CPU, each for itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numba
import numpy as np
from dante_w.field.cpu import step as fused
from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.adam import adam
from dante_w.field.cpu.kernels.decoder import OUTPUTS, Decoder, decode, decode_backward
from dante_w.field.cpu.kernels.grid import encode, load, scatter
from dante_w.field.cpu.kernels.loss import Shown, Weights, loss_backward
from dante_w.field.fields import Model
from dante_w.rays.ray_cache import Samples
from measure.stages import Stage

#: As `jit.njit_fast`, without a cache: that would not notice when the product's kernels change.
njit_fast = numba.njit(nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"})


def numba_stages(model: Model, samples: Samples) -> dict[str, Stage]:
    """Within a step they pass blocks and levels on in the cache, so they add up to more."""
    fields, count = (model.albedo, model.irradiance), len(samples.uv)
    grids, decoders = (
        [of(part) for part in parts]
        for of, parts in (
            (fused.grid_of, (field.grid for field in fields)),
            (fused.decoder_of, (field.decoder for field in fields)),
        )
    )
    points = samples.uv.numpy(), samples.position.numpy()
    pieces = fused.pieces_of(count, fused.PIECE)
    rows = np.random.default_rng(0).normal(0.0, 1e-6, (-(-count // BLOCK), 64, BLOCK)).astype(np.float32)
    gradients = [np.zeros_like(grid.tables) for grid in grids]
    moments = [(np.zeros_like(grid.tables), np.zeros_like(grid.tables)) for grid in grids]
    weights = Weights(*map(np.float32, (1e-5, 1e-6, 1e-6, 0.0, fused.DARKNESS)))

    def each(kernel: Callable[..., None], *arguments: object) -> None:
        fused.run(partial(kernel, *arguments, first, end) for first, end in pieces)

    def scatters() -> None:
        fused.run(
            partial(scatter, xyz, resolution, grid.shift, rows, 0, gradient[start:end])
            for grid, xyz, gradient in zip(grids, points, gradients, strict=True)
            for resolution, start, end in zip(grid.resolutions, grid.offsets, grid.offsets[1:], strict=False)
        )

    def backward() -> None:
        for decoder in decoders:
            each(_backward, decoder)
        scatters()

    def optimiser() -> None:
        arrays = (
            (grid.tables, *own, gradient)
            for grid, own, gradient in zip(grids, moments, gradients, strict=True)
        )
        fused.run(
            partial(
                adam, *(array[start:end].reshape(-1) for array in own), *(np.float32(1e-3), np.float32(1.0))
            )
            for grid, own in zip(grids, arrays, strict=True)
            for start, end in zip(grid.offsets, grid.offsets[1:], strict=False)
        )

    return {
        "encode 2D": Stage(partial(each, _encode, grids[0], points[0])),
        "encode 3D": Stage(partial(each, _encode, grids[1], points[1])),
        "decoders": Stage(lambda: [each(_decode, decoder) for decoder in decoders]),
        "loss": Stage(partial(each, _loss, weights)),
        "backward": Stage(backward),
        "optimiser": Stage(optimiser, before=scatters),
    }


@njit_fast
def _encode(grid, points, first, end):  # type: ignore[no-untyped-def]
    dimensions = points.shape[1]
    block = np.empty((dimensions, BLOCK), np.float32)
    entry, weight = np.empty((8, BLOCK), np.uint32), np.empty((8, BLOCK), np.float32)
    encoded = np.empty((len(grid.resolutions) * grid.tables.shape[1], BLOCK), np.float32)
    for start in range(first, end, BLOCK):
        load(points, start, block)
        encode(grid, block, entry, weight, encoded)


@njit_fast
def _decode(decoder, first, end):  # type: ignore[no-untyped-def]
    x = np.full((decoder.w1.shape[1], BLOCK), np.float32(0.5))
    hidden, out = np.empty((len(decoder.b1), BLOCK), np.float32), np.empty((OUTPUTS, BLOCK), np.float32)
    for _ in range(first, end, BLOCK):
        decode(decoder, x, hidden, out)


@njit_fast
def _backward(decoder, first, end):  # type: ignore[no-untyped-def]
    x = np.full((decoder.w1.shape[1], BLOCK), np.float32(0.5))
    hidden = np.full((len(decoder.b1), BLOCK), np.float32(0.5))
    upstream, d_hidden, d_x = (
        np.full((OUTPUTS, BLOCK), np.float32(0.5)),
        np.empty_like(hidden),
        np.empty_like(x),
    )
    gradient = Decoder(
        np.zeros_like(decoder.w1),
        np.zeros_like(decoder.b1),
        np.zeros_like(decoder.w2),
        np.zeros_like(decoder.b2),
    )
    for _ in range(first, end, BLOCK):
        decode_backward(decoder, x, hidden, upstream, d_hidden, d_x, gradient)


@njit_fast
def _loss(weights, first, end):  # type: ignore[no-untyped-def]
    half = np.full((3, BLOCK), np.float32(0.5))
    albedo, light, scratch, d_exposure, d_offset = (
        half.copy(),
        half.copy(),
        half.copy(),
        half.copy(),
        half.copy(),
    )
    shown = Shown(half, half, half, half, np.ones(BLOCK, np.float32))
    for _ in range(first, end, BLOCK):
        loss_backward(albedo, light, shown, weights, scratch, d_exposure, d_offset)
