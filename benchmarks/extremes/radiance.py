"""Radiance of any scale, exposures far apart, pixels that say nothing, albedo at either end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from extremes.judge import MODELS, alike, as_good, between, finite, refused, texel_centres, tried, unspoilt
from extremes.row import Row
from extremes.world import Outcome, World, albedo_at, make, with_priors

FAMILY = "radiance"
Photos = list[np.ndarray]


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    base = make()
    for model, options in MODELS.items():
        own = unspoilt(model)
        for scale in (1e-8, 1e-4, 1e4, 1e8):
            progress(f"radiance {scale:g}, {model}")
            world = replace(base, photos=[photo * np.float32(scale) for photo in base.photos])
            yield alike(FAMILY, f"radiance times {scale:g}, {model}", tried(world, *options), own, 50.0)
        for name, stops in (("5", 5.0), ("20", 20.0)):
            progress(f"exposures, {model}")
            spread = np.linspace(-stops, stops, len(base.photos))[[3, 0, 6, 1, 7, 4, 2, 5]]
            photos = [photo * np.float32(2.0**stop) for photo, stop in zip(base.photos, spread, strict=True)]
            world = replace(base, photos=photos)
            yield as_good(
                FAMILY, f"exposures from -{name} to +{name} stops, {model}", tried(world, *options), own, 2.0
            )
        for name, photos in odd_pixels(base).items():
            progress(f"{name}, {model}")
            yield as_good(FAMILY, f"{name}, {model}", tried(replace(base, photos=photos), *options), own, 2.0)
        for name, value in (("black", 0.0), ("NaN", np.nan), ("infinite", np.inf)):
            progress(f"all {name}, {model}")
            world = replace(base, photos=[np.full_like(photo, value) for photo in base.photos])
            yield refused(FAMILY, f"all photos {name}, {model}", tried(world, *options), "photos")
        progress(f"one colour, {model}")
        world = replace(base, photos=[np.full_like(photo, 0.4) for photo in base.photos])
        yield finite(FAMILY, f"all photos of one grey, {model}", tried(world, *options), varied=False)
        for name, factor in (("of 0.002 to 0.007", 0.01), ("of 0.02 to 0.07", 0.1), ("of 0.24 to 1", 1.5)):
            progress(f"albedo {name}, {model}")

            def painted(uv: np.ndarray, factor: float = factor) -> np.ndarray:
                return np.minimum(factor * albedo_at(uv), 1.0)

            outcome = tried(with_priors(make(albedo=painted), painted), *options)
            yield _level(f"albedo {name}, told by priors, {model}", outcome, painted)


def odd_pixels(world: World) -> dict[str, Photos]:
    """Photos of which some, or some pixels, say nothing or lie."""
    random = np.random.default_rng(7)
    shape = world.photos[0].shape[:2]

    def some(value: float, part: float) -> Photos:
        return [
            np.where((random.random(shape) < part)[..., None], np.float32(value), photo)
            for photo in world.photos
        ]

    def whole(value: float) -> Photos:
        return [*world.photos[:-1], np.full_like(world.photos[-1], value)]

    return {
        "one photo black": whole(0.0),
        "one photo saturated": whole(1e4),
        "one photo NaN": whole(np.nan),
        "5% of pixels black": some(0.0, 0.05),
        "0.5% of pixels saturated": some(1e6, 0.005),
        "5% of pixels NaN": some(np.nan, 0.05),
        "5% of pixels infinite": some(np.inf, 0.05),
        "5% of pixels negative": some(-0.1, 0.05),
    }


def _level(name: str, outcome: Outcome, painted: Callable[[np.ndarray], np.ndarray]) -> Row:
    """The albedo is right as it is, not only after a gain: priors tell its level."""
    bound = "PSNR at least 25 dB to the truth as it is, not one grey"
    if outcome.code or outcome.albedo is None:
        return Row(name, FAMILY, f"exit {outcome.code}", bound, False, outcome.message)
    truth = replace(outcome, albedo=painted(texel_centres(len(outcome.albedo))))
    value, spread = between(outcome, truth), float(outcome.albedo[outcome.seen].std() / truth.albedo.std())
    holds = value >= 25.0 and spread > 0.25 and not outcome.unsound
    measured = f"{value:.1f} dB, contrast {spread:.2f} of the truth's"
    return Row(name, FAMILY, measured, bound, holds, outcome.unsound)
