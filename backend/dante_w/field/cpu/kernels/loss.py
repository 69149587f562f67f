"""The loss of a block of samples and its gradient, as `field.loss.model_loss` defines it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dante_w.core.jit import njit_inlined
from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.functions import linear_from_srgb, log, sigmoid, softplus, srgb_from_linear

_INFINITE = np.float32(np.inf)
_ZERO, _ONE, _TWO, _THIRD = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1.0 / 3.0)


class Weights(NamedTuple):
    """Weight of each term in one channel of one sample, float32; 0 leaves the term out. `darkness` is `terms.DARKNESS`."""

    photometric: np.float32
    white_light: np.float32
    small_offset: np.float32
    prior: np.float32
    darkness: np.float32


class BlockSamples(NamedTuple):
    """What is known of a block's samples, float32.

    `exposure` e^w and `offset` of each sample's photo (3, BLOCK), linear; `colour` (3, BLOCK), sRGB-encoded; `prior`
    (4, BLOCK), sRGB-encoded, with its confidence; `weight` (BLOCK,). A prior that is not finite adds nothing.
    """

    exposure: np.ndarray
    offset: np.ndarray
    colour: np.ndarray
    prior: np.ndarray
    weight: np.ndarray


@njit_inlined
def loss_backward(albedo, light, samples, weights, log_light, d_exposure, d_offset):  # type: ignore[no-untyped-def]
    """Loss of a block, from what comes before sigmoid and softplus.

    Args:
        albedo, light: (OUTPUTS, BLOCK), the decoders' outputs; the first three rows are replaced by their gradients.
        samples, weights: BlockSamples and Weights.
        log_light: (3, BLOCK), scratch.
        d_exposure, d_offset: (3, BLOCK) to write, gradients with respect to w and b.
    """
    total = _ZERO
    if weights.photometric > _ZERO:
        for c in range(3):
            for s in range(BLOCK):
                log_light[c, s] = log(softplus(light[c, s]) + weights.darkness)
        for s in range(BLOCK):
            mean = (log_light[0, s] + log_light[1, s] + log_light[2, s]) * _THIRD
            log_light[0, s] -= mean
            log_light[1, s] -= mean
            log_light[2, s] -= mean
    for c in range(3):
        for s in range(BLOCK):
            sample_weight = samples.weight[s]
            a = sigmoid(albedo[c, s])
            d_a = d_light = d_w = d_b = loss = _ZERO
            if weights.photometric > _ZERO:
                irradiance, exposure = softplus(light[c, s]), samples.exposure[c, s]
                value, slope = srgb_from_linear(exposure * a * irradiance + samples.offset[c, s])
                size, sign = _magnitude(value - samples.colour[c, s])
                d_colour = weights.photometric * sign * slope
                tint, b = log_light[c, s], samples.offset[c, s]
                offset, offset_sign = _magnitude(b)
                loss = weights.photometric * size
                loss += weights.white_light * tint * tint + weights.small_offset * offset
                d_a = d_colour * exposure * irradiance
                d_w = d_colour * exposure * irradiance * a
                d_b = d_colour + weights.small_offset * offset_sign
                d_light = d_colour * exposure * a
                d_light += _TWO * weights.white_light * tint / (irradiance + weights.darkness)
                d_light *= sigmoid(light[c, s])
            if weights.prior > _ZERO:
                prior, confidence = samples.prior[c, s], samples.prior[3, s]
                known = abs(prior) < _INFINITE and abs(confidence) < _INFINITE
                size, sign = _magnitude(a - linear_from_srgb(prior if known else _ZERO))
                weight = weights.prior * confidence if known else _ZERO
                loss += weight * size
                d_a += weight * sign
            total += sample_weight * loss
            albedo[c, s] = sample_weight * d_a * a * (_ONE - a)
            light[c, s] = sample_weight * d_light
            d_exposure[c, s] = sample_weight * d_w
            d_offset[c, s] = sample_weight * d_b
    return total


@njit_inlined
def _magnitude(x):  # type: ignore[no-untyped-def]
    """|x| and its slope; both 0 where x is not a number."""
    sign = _ONE if x > _ZERO else (-_ONE if x < _ZERO else _ZERO)
    return (x if x > _ZERO else (-x if x < _ZERO else _ZERO)), sign
