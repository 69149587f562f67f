"""What photos alone leave open: one gain per channel between albedo and light.

(a g) (s / g) explains a photo as well as a s does. With priors the priors decide; without them this module does,
by stated rules and nothing else.
"""

from __future__ import annotations

import numpy as np
import torch

from dante_w.core.color import linear_from_srgb
from dante_w.field.fields import Model
from dante_w.rays.ray_cache import RayCache

#: Samples that the rules look at.
SAMPLES = 1 << 17
#: Albedo times irradiance of the untrained model: 0.5 x softplus(0).
UNTRAINED = 0.35
#: The brightest texels, at this quantile of the largest channel, ...
BRIGHTEST = 0.99
#: ... end up with an albedo inside these physical bounds (charcoal-grey objects; snow).
BOUNDS = (0.3, 0.9)


def start_exposures(model: Model, cache: RayCache) -> None:
    """Start each photo's w_k where its mean brightness is explained, so that exposures need not be searched."""
    for photo, (first, end) in enumerate(zip(cache.starts[:-1], cache.starts[1:], strict=True)):
        if end > first:
            index = np.linspace(first, end - 1, min(end - first, 4096)).astype(np.int64)
            mean = linear_from_srgb(torch.from_numpy(cache.colour[index]).float()).mean()
            model.log_exposure.data[photo] = torch.log(mean.clamp_min(1e-6) / UNTRAINED)


@torch.no_grad()
def albedo_gain(model: Model, cache: RayCache, ranges: np.ndarray, seed: int) -> torch.Tensor:
    """The gain (3,) on linear albedo that the rules ask for.

    1. White point: light is white and well exposed on average, so over all samples the mean albedo equals the
       mean linear colour of the photos, channel by channel.
    2. Physical bounds: one further gain for all channels, if the brightest texels need it to fall in `BOUNDS`.
    """
    generator = np.random.default_rng(seed)
    lengths = ranges[:, 1] - ranges[:, 0]
    which = generator.choice(len(ranges), SAMPLES, p=lengths / lengths.sum())
    index = ranges[which, 0] + (generator.random(SAMPLES) * lengths[which]).astype(np.int64)
    samples = cache.samples(np.sort(index), model.offset.device)
    albedo = model.albedo(samples.uv)
    gain = linear_from_srgb(samples.colour).clamp_min(0.0).mean(0) / albedo.mean(0)
    brightest = (albedo * gain).amax(1).quantile(BRIGHTEST)
    return gain * (brightest.clamp(*BOUNDS) / brightest)
