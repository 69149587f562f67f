"""The model: fine albedo over the texture, coarse irradiance over space, and each photo's exposure.

Its definition, in plain torch for any device and precision. Steps of the fit and values without gradients come from
faster code where there is some: see `optimise.step_for` and `inference`. All colours are linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from dante_w.field.hash_encoding import GridSpec, HashGrid

#: |w_k| counts as at most this: e^20 is 29 stops.
EXTREME_EXPOSURE = 20.0
#: Standard deviation of a new photo embedding.
EMBEDDING_SPREAD = 0.1


@dataclass(frozen=True)
class FieldSpec:
    """The size of the model."""

    #: Encoding of texture coordinates, for albedo. The gap between the finest resolutions of the two encodings is what
    #: separates albedo from irradiance.
    albedo: GridSpec
    #: Encoding of positions, for irradiance.
    irradiance: GridSpec
    #: Units of the one hidden layer in either decoder.
    hidden: int = 64
    #: Length of the per-photo embedding e_k.
    embedding: int = 8


class AlbedoField(nn.Module):
    """a = sigmoid(MLP(hash2D(u))), Eq. 3: texture coordinates (N, 2) to albedo (N, 3) in (0, 1)."""

    def __init__(self, grid: GridSpec, hidden: int) -> None:
        super().__init__()
        self.grid = HashGrid(grid)
        self.decoder = _decoder(grid.width, hidden)

    def forward(self, uv: torch.Tensor) -> torch.Tensor:
        return self.decode(self.grid(uv))

    def decode(self, encoded: torch.Tensor) -> torch.Tensor:
        """Albedo (N, 3) at encoded texture coordinates (N, L * F)."""
        return self.activation(self.decoder(encoded))

    @staticmethod
    def activation(raw: torch.Tensor) -> torch.Tensor:
        """The decoder's output to albedo."""
        return torch.sigmoid(raw)


class IrradianceField(nn.Module):
    """s = softplus(MLP(hash3D(x), e_k)), Eq. 5: positions (N, 3) in the unit cube and photo embeddings (N, E) to
    irradiance (N, 3) >= 0, without an upper bound."""

    def __init__(self, grid: GridSpec, hidden: int, embedding: int) -> None:
        super().__init__()
        self.grid = HashGrid(grid)
        self.decoder = _decoder(grid.width + embedding, hidden)

    def forward(self, position: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        return self.decode(self.grid(position), embedding)

    def decode(self, encoded: torch.Tensor, embedding: torch.Tensor) -> torch.Tensor:
        """Irradiance (N, 3) at encoded positions (N, L * F)."""
        return self.activation(self.decoder(torch.cat([encoded, embedding], dim=1)))

    @staticmethod
    def activation(raw: torch.Tensor) -> torch.Tensor:
        """The decoder's output to irradiance."""
        return nn.functional.softplus(raw)


class FieldModel(nn.Module):
    """Colour of sample r in photo k: c = exp(w_k) (a * s) + b_k (Eq. 1 with exposure compensation).

    `log_exposure` (K, 3) holds w_k, `offset` (K, 3) holds b_k, `embedding` (K, E) holds e_k ~ N(0, 0.1).
    """

    def __init__(self, spec: FieldSpec, photos: int) -> None:
        super().__init__()
        self.spec = spec
        self.albedo = AlbedoField(spec.albedo, spec.hidden)
        self.irradiance = IrradianceField(spec.irradiance, spec.hidden, spec.embedding)
        self.embedding = nn.Parameter(EMBEDDING_SPREAD * torch.randn(photos, spec.embedding))
        self.log_exposure = nn.Parameter(torch.zeros(photos, 3))
        self.offset = nn.Parameter(torch.zeros(photos, 3))

    def light(self, position: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
        """Irradiance s (N, 3) at positions (N, 3), as the given photos (N,) were taken in."""
        irradiance: torch.Tensor = self.irradiance(position, self.embedding[photo])
        return irradiance

    def expose(self, radiance: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
        """Linear colours c (N, 3) of a * s (N, 3) under the exposures of the given photos (N,)."""
        log_exposure = self.log_exposure.clamp(-EXTREME_EXPOSURE, EXTREME_EXPOSURE)
        return torch.exp(log_exposure[photo]) * radiance + self.offset[photo]

    def photo_parameters(self) -> list[nn.Parameter]:
        """e_k, w_k and b_k: what belongs to single photos."""
        return [self.embedding, self.log_exposure, self.offset]


def _decoder(inputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 3))
