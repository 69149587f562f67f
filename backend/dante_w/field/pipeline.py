"""The whole fit: without the held-out photos, scored on them, then with all photos; and the albedo that comes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from dante_w.contract.errors import DanteError
from dante_w.field.fields import FieldModel
from dante_w.field.fit_state import SavePoint
from dante_w.field.held_out import held_out_psnr
from dante_w.field.inference import albedo_at
from dante_w.field.optimise import Problem, fit, photo_ranges
from dante_w.field.scale_ambiguity import start_exposures
from dante_w.field.settings import FieldSettings
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import RayCache
from dante_w.run.checkpoints import Checkpoints
from dante_w.run.progress import Progress
from dante_w.run.setbacks import Setback


@dataclass(frozen=True)
class FieldRun:
    """What is fitted, how, and where.

    Attributes:
        settings: with the model's size as it is fitted, see `FieldSettings.spec_for`.
        held_out: (H,) indices of the photos that the main pass does not see.
        final_pass: whether the fit goes on with all photos after it was scored.
    """

    settings: FieldSettings
    terms: LossTerms
    held_out: np.ndarray
    device: torch.device
    seed: int
    final_pass: bool


@dataclass(frozen=True)
class FieldResult:
    """The fitted model, its PSNR in dB on the held-out photos (None if there is none), and each stage's setbacks."""

    model: FieldModel
    held_out_psnr: float | None
    setbacks: dict[str, list[Setback]]


def fit_field(cache: RayCache, run: FieldRun, progress: Progress, checkpoints: Checkpoints) -> FieldResult:
    """Fit both fields to the photos.

    Raises:
        DanteError: the fit does not come to anything.
    """
    photos, settings, held_out = np.arange(len(cache.starts) - 1), run.settings, run.held_out

    def report(stage: str) -> Callable[[int, int, float], None]:
        return lambda step, steps, loss: progress.update(stage, step, steps, loss)

    progress.update("optimise", 0, settings.schedule.steps)
    torch.manual_seed(run.seed)
    model = FieldModel(settings.model, len(photos))
    start_exposures(model, cache, settings.scale)
    model.to(run.device)
    training = photo_ranges(cache, np.setdiff1d(photos, held_out))
    if len(training) == 0:
        held_out, training = held_out[:0], photo_ranges(cache, photos)
    result = fit(
        Problem(model, cache, training, run.terms),
        settings.schedule,
        run.seed,
        report("optimise"),
        settings.fit,
        SavePoint(checkpoints, "fit"),
    )
    if result.failed(settings.fit.divergence):
        raise DanteError(
            "The fit diverged or explained nothing, so there is no texture; run again with another --seed or --lambda."
        )
    setbacks, score = {"optimise": result.setbacks}, None
    if len(held_out) and run.terms.photometric:
        score, setbacks["held-out"] = held_out_psnr(
            model, cache, held_out, run.seed, report("held-out"), settings.held_out, settings.fit
        )
    if len(held_out) and run.final_pass:
        progress.update("final pass", 0, settings.final_pass.steps)
        result = fit(
            Problem(model, cache, photo_ranges(cache, photos), run.terms),
            settings.final_pass,
            run.seed + 1,
            report("final pass"),
            settings.fit,
            SavePoint(checkpoints, "final fit"),
        )
        setbacks["final pass"] = result.setbacks
    return FieldResult(model, score, setbacks)


def albedo_lookup(model: FieldModel, gain: torch.Tensor) -> Callable[[np.ndarray], np.ndarray]:
    """A function from texture coordinates (N, 2) to linear albedo (N, 3) in [0, 1], times `gain` (3,) on the CPU."""

    def albedo(uv: np.ndarray) -> np.ndarray:
        points = torch.from_numpy(uv).float().to(model.offset.device)
        return (albedo_at(model, points).cpu() * gain).clamp(0.0, 1.0).numpy()

    return albedo
