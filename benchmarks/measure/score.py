"""Scores of a result: its pictures in the test views held against the truth, as they are and after gains.

"After gain" forgives the overall colour that photos alone leave open: one factor per channel for the whole
object (not one per view), least squares in linear light over the foreground of all its pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from measure.metrics import apply_gains, gains, psnr
from measure.pictures import read
from measure.views import linear_texture, viewer_of

#: (picture, truth, mask) to one number.
Metric = Callable[[np.ndarray, np.ndarray, np.ndarray], float]
PSNR: dict[str, Metric] = {"PSNR": psnr}
AFTER_GAIN = " after gain"
SOLID = 0.999  # alpha of a pixel that shows the object alone


class View(NamedTuple):
    """A picture and its truth, (H, W, 3) sRGB in [0, 1], and the (H, W) pixels that count."""

    picture: np.ndarray
    truth: np.ndarray
    mask: np.ndarray


def compare(views: Sequence[View], metrics: Mapping[str, Metric] = PSNR) -> dict[str, float]:
    """Each metric's mean over `views`, under its name, and after gains under `NAME after gain`."""
    ours, truth, mask = (np.concatenate([view[part] for view in views]) for part in range(3))
    factors = gains(ours, truth, mask)
    scores = {}
    for name, metric in metrics.items():
        scores[name] = float(np.mean([metric(*view) for view in views]))
        after = [metric(apply_gains(view.picture, factors), view.truth, view.mask) for view in views]
        scores[name + AFTER_GAIN] = float(np.mean(after))
    return scores


def albedo_views(result: Path, scene: Path) -> list[View]:
    """What the scene's test cameras see of a result's albedo, and the true albedo they saw."""
    viewer, texture = viewer_of(result, scene), linear_texture(result)
    views = []
    for index, file in enumerate(viewer.truth):
        truth, alpha = read(file)
        picture, full = viewer.view(texture, index)
        views.append(View(picture, truth, full & (alpha > SOLID)))
    return views


def file_views(pictures: Sequence[Path], truths: Sequence[Path]) -> list[View]:
    """Pictures in files against their truths; what counts is where the truth is solid."""
    views = []
    for picture, file in zip(pictures, truths, strict=True):
        truth, alpha = read(file)
        views.append(View(read(picture)[0], truth, alpha > SOLID))
    return views


def score(result: Path, scene: Path, metrics: Mapping[str, Metric] = PSNR) -> dict[str, float]:
    """Every metric of a result's albedo in the scene's test views."""
    return compare(albedo_views(result, scene), metrics)
