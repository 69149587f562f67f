"""The whole model over a batch, a piece at a time: values, or loss and gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dante_w.core.jit import njit_fast, njit_inlined
from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.decoder import OUTPUTS, decode, decode_backward
from dante_w.field.cpu.kernels.grid import encode, load
from dante_w.field.cpu.kernels.loss import BlockSamples, loss_backward

_ZERO = np.float32(0.0)


class Batch(NamedTuple):
    """As `ray_cache.Samples`: `photo` (N,) int64, `uv` (N, 2), `position` (N, 3), `colour` (N, 3), `prior` (N, 4)
    and `weight` (N,) float32; `prior` is (0, 4) without priors."""

    photo: np.ndarray
    uv: np.ndarray
    position: np.ndarray
    colour: np.ndarray
    prior: np.ndarray
    weight: np.ndarray


class Photos(NamedTuple):
    """`embedding` (K, E), `exposure` e^w (K, 3) and `offset` (K, 3) of the photos, float32."""

    embedding: np.ndarray
    exposure: np.ndarray
    offset: np.ndarray


@njit_fast
def evaluate(points, extra, grid, decoder, first, end, out):  # type: ignore[no-untyped-def]
    """Write the decoder's output for the points `first` to `end` into `out` (N, 3), before its activation.

    Args:
        points: (N, D) float32.
        extra: (N, E) float32, further inputs of the decoder.
        grid, decoder: Grid and Decoder.
    """
    dimensions, width = points.shape[1], len(grid.resolutions) * grid.tables.shape[1]
    block = np.empty((dimensions, BLOCK), np.float32)
    entry = np.empty((1 << dimensions, BLOCK), np.uint32)
    weight = np.empty((1 << dimensions, BLOCK), np.float32)
    x = np.zeros((width + extra.shape[1], BLOCK), np.float32)
    hidden, raw = np.empty((len(decoder.b1), BLOCK), np.float32), np.empty((OUTPUTS, BLOCK), np.float32)
    for start in range(first, end, BLOCK):
        count = min(BLOCK, end - start)
        load(points, start, block)
        encode(grid, block, entry, weight, x)
        for e in range(extra.shape[1]):
            for s in range(count):
                x[width + e, s] = extra[start + s, e]
        decode(decoder, x, hidden, raw)
        for s in range(count):
            for c in range(3):
                out[start + s, c] = raw[c, s]


@njit_fast
def gradients(  # type: ignore[no-untyped-def]
    batch, first, end, albedo, albedo_decoder, light, light_decoder, photos, weights, rows, d_albedo, d_light
):
    """Loss of samples `first` to `end`, multiples of BLOCK but for the last.

    Args:
        batch, photos, weights: Batch, Photos and `loss.Weights`.
        albedo, light: Grids, with their Decoders.
        rows: (blocks, R, BLOCK), to write: gradients with respect to each sample's encoded albedo, encoded light,
            embedding, w and b, in this order.
        d_albedo, d_light: the decoders' gradients, which are added to.
    """
    a_width = len(albedo.resolutions) * albedo.tables.shape[1]
    l_width = len(light.resolutions) * light.tables.shape[1]
    embedding = photos.embedding.shape[1]
    uv, position = np.empty((2, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
    entry, weight = np.empty((8, BLOCK), np.uint32), np.empty((8, BLOCK), np.float32)
    a_x, l_x = np.empty((a_width, BLOCK), np.float32), np.empty((l_width + embedding, BLOCK), np.float32)
    a_hidden = np.empty((len(albedo_decoder.b1), BLOCK), np.float32)
    l_hidden = np.empty((len(light_decoder.b1), BLOCK), np.float32)
    a_back, l_back = np.empty_like(a_hidden), np.empty_like(l_hidden)
    a_raw, l_raw, log_light = (
        np.empty((OUTPUTS, BLOCK), np.float32),
        np.zeros((OUTPUTS, BLOCK), np.float32),
        np.empty((3, BLOCK), np.float32),
    )
    samples = BlockSamples(
        np.zeros((3, BLOCK), np.float32),
        np.zeros((3, BLOCK), np.float32),
        np.zeros((3, BLOCK), np.float32),  # what is past the end weighs 0, but has to be finite
        np.full((4, BLOCK), np.float32(np.nan)),
        np.empty(BLOCK, np.float32),
    )
    photo = np.empty(BLOCK, np.int64)
    photometric = weights.photometric > _ZERO
    w_row = a_width + l_width + embedding
    b_row = w_row + 3
    loss = 0.0
    for start in range(first, end, BLOCK):
        count = min(BLOCK, end - start)
        load(batch.uv, start, uv)
        encode(albedo, uv, entry, weight, a_x)
        decode(albedo_decoder, a_x, a_hidden, a_raw)
        if photometric:
            load(batch.position, start, position)
            encode(light, position, entry, weight, l_x)
            for s in range(BLOCK):
                photo[s] = batch.photo[min(start + s, end - 1)]
            _fetch(photos.embedding, photo, l_x[l_width:])
            _fetch(photos.exposure, photo, samples.exposure)
            _fetch(photos.offset, photo, samples.offset)
            decode(light_decoder, l_x, l_hidden, l_raw)
        samples.weight[:] = _ZERO
        for s in range(count):
            samples.weight[s] = batch.weight[start + s]
        for c in range(3):
            for s in range(count):
                samples.colour[c, s] = batch.colour[start + s, c]
        if len(batch.prior) > 0:
            for c in range(4):
                for s in range(count):
                    samples.prior[c, s] = batch.prior[start + s, c]
        row = rows[start // BLOCK]
        loss += loss_backward(a_raw, l_raw, samples, weights, log_light, row[w_row:b_row], row[b_row:])
        decode_backward(albedo_decoder, a_x, a_hidden, a_raw, a_back, row[:a_width], d_albedo)
        if photometric:
            decode_backward(light_decoder, l_x, l_hidden, l_raw, l_back, row[a_width:w_row], d_light)
    return loss


@njit_inlined
def _fetch(values, photo, block):  # type: ignore[no-untyped-def]
    """Write the values (K, W) of each sample's photo into `block` (W, BLOCK); `photo` (BLOCK,)."""
    for w in range(len(block)):
        for s in range(BLOCK):
            block[w, s] = values[photo[s], w]


@njit_fast
def scatter_photos(photo, rows, first_row, gradient):  # type: ignore[no-untyped-def]
    """Add each sample's gradients to those of its photo, `gradient` (K, W).

    Args:
        photo: (N,) int64.
        rows: (blocks, R, BLOCK); the W rows from `first_row` on are taken.
    """
    for start in range(0, len(photo), BLOCK):
        block, count = rows[start // BLOCK], min(BLOCK, len(photo) - start)
        first = 0
        while first < count:  # neighbours mostly belong to one photo
            k, end = photo[start + first], first + 1
            while end < count and photo[start + end] == k:
                end += 1
            for w in range(gradient.shape[1]):
                total = _ZERO
                for s in range(first, end):
                    total += block[first_row + w, s]
                gradient[k, w] += total
            first = end
