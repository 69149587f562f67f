"""Values of the fields without gradients, by the fastest code for where the model is."""

from __future__ import annotations

import math

import numpy as np
import torch

from dante_w.core.color import srgb_from_linear
from dante_w.field.cpu import step as cpu_step
from dante_w.field.cuda import grid as cuda_grid
from dante_w.field.fields import AlbedoField, FieldModel, IrradianceField
from dante_w.rays.ray_cache import RayCache

#: Samples that are re-rendered at once.
SAMPLES_AT_ONCE = 1 << 17


@torch.no_grad()
def albedo_at(model: FieldModel, uv: torch.Tensor) -> torch.Tensor:
    """Linear albedo (N, 3) at texture coordinates (N, 2)."""
    return model.albedo.activation(_decoded(model.albedo, uv, None))


@torch.no_grad()
def light_at(model: FieldModel, position: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
    """Irradiance (N, 3) at positions (N, 3) in the unit cube, as the photos (N,) were taken in."""
    return model.irradiance.activation(_decoded(model.irradiance, position, model.embedding[photo]))


@torch.no_grad()
def psnr(model: FieldModel, cache: RayCache, index: np.ndarray) -> float:
    """PSNR in dB of re-rendered sRGB colours against the photos at the samples `index` (N,)."""
    device = model.offset.device
    squared, count = 0.0, 0
    for start in range(0, len(index), SAMPLES_AT_ONCE):
        samples = cache.samples(index[start : start + SAMPLES_AT_ONCE], device)
        light = light_at(model, samples.position, samples.photo)
        colour = model.expose(albedo_at(model, samples.uv) * light, samples.photo)
        error = srgb_from_linear(colour).clamp(0.0, 1.0) - samples.colour.clamp(0.0, 1.0)
        squared += float(error.square().mean()) * error.numel()  # there is no float64 on Apple's GPUs
        count += error.numel()
    return -10.0 * math.log10(max(squared / max(count, 1), 1e-12))


def _decoded(
    field: AlbedoField | IrradianceField, points: torch.Tensor, embedding: torch.Tensor | None
) -> torch.Tensor:
    """What the field's decoder gives (N, 3) for points (N, D) and embeddings (N, E), before its activation."""
    grid, decoder = field.grid, field.decoder
    if cpu_step.supports(grid, decoder):
        return cpu_step.decode_points(grid, decoder, points, embedding)
    on_gpu = cuda_grid.supports(grid)
    encoded = cuda_grid.encode(points, grid.tables, grid.spec) if on_gpu else grid(points)
    raw: torch.Tensor = decoder(encoded if embedding is None else torch.cat([encoded, embedding], dim=1))
    return raw
