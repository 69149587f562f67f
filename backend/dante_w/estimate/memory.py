"""What a run needs of memory at most, from the sizes of the arrays it will hold.

The bytes of each are measured (Linux, two cores). With them peaks come out within a quarter of `peak_memory_bytes` on objects of 40 photos and
on fountain-P11; most of the error is in the number of lights, which a plan can only guess."""

from __future__ import annotations

import psutil

from dante_w.field.fields import FieldSpec
from dante_w.rays.ray_cache import sample_bytes

#: Bytes a texel of a texture that is averaged from photos: colours and weights on a pyramid, then two copies in float; and of one
#: that is only baked.
AVERAGED, BAKED = 40, 8
#: Bytes a sample of the photo at work, while its colours are divided by their light.
SAMPLE = 320
#: Bytes an observation of a shading point, while lights are solved for.
OBSERVATION = 400
#: Bytes an entry of the normal equations: in float32, and in double with its copies and its factor.
ENTRY = 30
#: Kernels and parts of libraries that are only loaded once lights are solved for.
LATER = 150_000_000
#: Bytes a shading point and direction: visibility and transfer.
TRANSFER = 8
#: Bytes a ray of bounced light.
BOUNCE = 8
#: Bytes a parameter of a fit: itself, its gradient and two moments.
PARAMETER = 16


def resident() -> int:
    """What this process holds now, in bytes."""
    return int(psutil.Process().memory_info().rss)


def room() -> int:
    """What this process could hold, in bytes: what it does, and what is free."""
    return resident() + int(psutil.virtual_memory().available)


def cache_bytes(samples: int, prior: bool) -> int:
    """The ray cache in memory."""
    return samples * sample_bytes(prior)


def texture_bytes(side: int, samples: int) -> int:
    """A texture of side x side texels averaged from photos of so many samples at most."""
    return AVERAGED * side**2 + SAMPLE * samples


def lights_bytes(observations: int, lights: int, directions: int, photos: int) -> int:
    """Solving for the lights."""
    return OBSERVATION * observations + ENTRY * (3 * lights * directions + photos + 1) ** 2


def fit_bytes(spec: FieldSpec) -> int:
    """Fitting the paper's model, whose decoders are small beside its grids."""
    grids = (spec.albedo, spec.irradiance)
    return PARAMETER * sum(sum(grid.entries) * grid.features for grid in grids)
