"""The two fields of the model: fine albedo over the texture, coarse irradiance over space.

All colours are linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from dante_w.field.cpu import step as fused
from dante_w.field.cuda import grid as triton_grid
from dante_w.field.hash_encoding import GridSpec, HashGrid


@dataclass(frozen=True)
class ModelSpec:
    """What the model is made of.

    albedo, irradiance: their encodings. The gap between their finest resolutions is what separates them.
    hidden: width of the one hidden layer in either decoder.
    embedding: length of the per-photo embedding e_k.
    """

    albedo: GridSpec
    irradiance: GridSpec
    hidden: int = 64
    embedding: int = 8


class AlbedoField(nn.Module):
    """a = sigmoid(MLP(hash2D(u))), Eq. 3: texture coordinates (N, 2) to albedo (N, 3) in (0, 1)."""

    def __init__(self, grid: GridSpec, hidden: int) -> None:
        super().__init__()
        self.grid = HashGrid(grid)
        self.decoder = _decoder(grid.width, hidden)

    def forward(self, uv: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(_decoded(self.grid, self.decoder, uv))

    def of_encoded(self, encoded: torch.Tensor) -> torch.Tensor:
        """The same from encoded texture coordinates (N, L * F)."""
        return torch.sigmoid(self.decoder(encoded))


class IrradianceField(nn.Module):
    """s = softplus(MLP(hash3D(x), e_k)), Eq. 5: positions (N, 3) in the unit cube and photo embeddings (N, E) to
    irradiance (N, 3) >= 0, without an upper bound."""

    def __init__(self, grid: GridSpec, hidden: int, embedding: int) -> None:
        super().__init__()
        self.grid = HashGrid(grid)
        self.decoder = _decoder(grid.width + embedding, hidden)

    def forward(self, position: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        return nn.functional.softplus(_decoded(self.grid, self.decoder, position, embedding))

    def of_encoded(self, encoded: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        """The same from encoded positions (N, L * F)."""
        return nn.functional.softplus(self.decoder(torch.cat([encoded, embedding], dim=1)))


class Model(nn.Module):
    """Colour of sample r in photo k: c = exp(w_k) (a * s) + b_k (Eq. 1 with exposure compensation).

    `log_exposure` (K, 3) holds w_k, `offset` (K, 3) holds b_k, `embedding` (K, E) holds e_k ~ N(0, 0.1).
    """

    def __init__(self, spec: ModelSpec, photos: int) -> None:
        super().__init__()
        self.spec = spec
        self.albedo = AlbedoField(spec.albedo, spec.hidden)
        self.irradiance = IrradianceField(spec.irradiance, spec.hidden, spec.embedding)
        self.embedding = nn.Parameter(0.1 * torch.randn(photos, spec.embedding))
        self.log_exposure = nn.Parameter(torch.zeros(photos, 3))
        self.offset = nn.Parameter(torch.zeros(photos, 3))

    def light(self, position: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
        """Irradiance s (N, 3) at positions (N, 3), as the given photos (N,) were taken in."""
        return self.irradiance(position, self.embedding[photo])

    def expose(self, radiance: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
        """Linear colours c (N, 3) of a * s as the given photos' exposure shows them."""
        log_exposure = self.log_exposure.clamp(-fused.EXTREME_EXPOSURE, fused.EXTREME_EXPOSURE)
        return torch.exp(log_exposure[photo]) * radiance + self.offset[photo]

    def photo_parameters(self) -> list[nn.Parameter]:
        """e_k, w_k and b_k: what belongs to single photos."""
        return [self.embedding, self.log_exposure, self.offset]


def _decoded(
    grid: HashGrid, decoder: nn.Module, points: torch.Tensor, extra: torch.Tensor | None = None
) -> torch.Tensor:
    """What the decoder (N, 3) makes of encoded points (N, D) and further inputs (N, E). Where no gradients are wanted
    the kernels compute what they can, else plain torch."""
    training = torch.is_grad_enabled()
    if not training and fused.computes(grid, decoder):
        return fused.decoded(grid, decoder, points, extra)
    by_triton = not training and triton_grid.computes(grid)
    encoded = triton_grid.encode(points, grid.tables, grid.spec) if by_triton else grid(points)
    raw: torch.Tensor = decoder(encoded if extra is None else torch.cat([encoded, extra], dim=1))
    return raw


def _decoder(inputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 3))
