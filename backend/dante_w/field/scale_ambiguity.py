"""What photos alone leave open: one gain per channel between albedo and light.

(a g) (s / g) explains a photo as well as a s does. With priors the priors decide; without them this module does,
by stated rules and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from dante_w.core.color import linear_from_srgb
from dante_w.field.fields import FieldModel
from dante_w.field.inference import albedo_at
from dante_w.rays.ray_cache import RayCache

#: Albedo times irradiance of the untrained model: 0.5 x softplus(0).
UNTRAINED = 0.35


@dataclass(frozen=True)
class ScaleSettings:
    """The rules that choose the gain, and how many samples they look at."""

    #: Samples of a photo whose mean brightness its first exposure explains.
    photo_samples: int = 4096
    #: Samples of all photos that the gain is chosen by.
    samples: int = 1 << 17
    #: The brightest samples' albedo is that at this quantile of the largest channel, so that highlights do not count.
    brightest: float = 0.99
    #: Linear albedo that the brightest samples may have: that of charcoal-grey objects, and that of snow.
    bounds: tuple[float, float] = (0.3, 0.9)


SCALE = ScaleSettings()


def start_exposures(model: FieldModel, cache: RayCache, settings: ScaleSettings = SCALE) -> None:
    """Start each photo's w_k where its mean brightness is explained, so that exposures need not be searched."""
    for photo, (first, end) in enumerate(zip(cache.starts[:-1], cache.starts[1:], strict=True)):
        if end > first:
            index = np.linspace(first, end - 1, min(end - first, settings.photo_samples)).astype(np.int64)
            mean = linear_from_srgb(torch.from_numpy(cache.colour[index]).float()).mean()
            model.log_exposure.data[photo] = torch.log(mean.clamp_min(1e-6) / UNTRAINED)


@torch.no_grad()
def albedo_gain(
    model: FieldModel, cache: RayCache, ranges: np.ndarray, seed: int, settings: ScaleSettings = SCALE
) -> torch.Tensor:
    """The gain (3,) on linear albedo that the rules ask for, over samples of `ranges` (R, 2).

    1. White point: light is white and well exposed on average, so over all samples the mean albedo equals the
       mean linear colour of the photos, channel by channel.
    2. Physical bounds: one further gain for all channels, if the brightest samples need it to fall into `bounds`.
    """
    generator = np.random.default_rng(seed)
    lengths = ranges[:, 1] - ranges[:, 0]
    drawn = generator.choice(len(ranges), settings.samples, p=lengths / lengths.sum())
    index = ranges[drawn, 0] + (generator.random(settings.samples) * lengths[drawn]).astype(np.int64)
    samples = cache.samples(np.sort(index), model.offset.device)
    albedo = albedo_at(model, samples.uv)
    gain = linear_from_srgb(samples.colour).clamp_min(0.0).mean(0) / albedo.mean(0)
    brightest = (albedo * gain).amax(1).quantile(settings.brightest)
    return gain * (brightest.clamp(*settings.bounds) / brightest)
