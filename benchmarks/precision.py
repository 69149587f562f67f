"""What rounding costs: `python3 dev.py bench precision [--steps N] [--json]`.

A small fixed problem, the product's own loss and fit, and every precision against float64: the error of one
step (fields, loss, gradients) at the model that float64 has fitted, then a whole fit from the same start with
the same batches. How far two fits drift apart anyway is told by float64 from a start moved in its 12th digit,
from one moved as far as float32 rounds, and with other batches. Needs no data. Prints Markdown tables.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from unittest import mock

import numpy as np
import torch
from dante_w.field import optimise
from dante_w.field.cpu import step as fused
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import LossTerms, Schedule, fit, model_loss
from dante_w.field.presets import SMALL_OFFSET, WHITE_LIGHT
from measure.machine import provenance, sentence
from measure.metrics import apply_gains, gains, psnr, srgb_from_linear
from measure.synthetic_scene import SphereSamples, albedo_at

#: The presets' shape with fewer and smaller tables: the torch path's backward pass writes every table once per corner.
SPEC = ModelSpec(
    albedo=GridSpec(2, levels=8, features=2, coarsest=16, finest=512, log2_table=13),
    irradiance=GridSpec(3, levels=4, features=2, coarsest=4, finest=16, log2_table=12),
    hidden=32,
)
TERMS = LossTerms(white_light=WHITE_LIGHT, small_offset=SMALL_OFFSET)
PHOTOS, SAMPLES_PER_PHOTO, BATCH = 8, 8192, 4096
TEXTURE = 256  # side of the texture that is compared, in texels
CLUSTERS = ("tables", "decoders", "photos")


@dataclass(frozen=True)
class Way:
    """One way to compute.

    dtype: of the parameters, and so of the encoding. autocast: what the decoders' matrix products are done in, if
    not in that. reference: plain torch, in place of what the device gets. moved: the start is
    off by about this fraction of itself. seed: of the batches. loss_scale: the loss is multiplied by this, without
    which float16 loses small gradients.
    """

    name: str
    dtype: torch.dtype
    autocast: torch.dtype | None = None
    reference: bool = True
    device: str = "cpu"
    moved: float = 0.0
    seed: int = 3
    loss_scale: float = 1.0


EXACT = Way("float64", torch.float64)
WAYS = [
    Way("float64, start moved by 1e-12", torch.float64, moved=1e-12),
    Way("float64, start moved by 6e-8", torch.float64, moved=2.0**-24),
    Way("float64, other batches", torch.float64, seed=4),
    Way("float32, torch", torch.float32),
    Way("float32, numba (the product on a CPU)", torch.float32, reference=False),
    Way("bfloat16 autocast", torch.float32, torch.bfloat16),
    Way("float16 autocast", torch.float32, torch.float16, loss_scale=1024.0),
    Way("bfloat16 parameters", torch.bfloat16),
    Way("float16 parameters", torch.float16, loss_scale=1024.0),
]
GPU_WAYS = [
    Way("float32, CUDA", torch.float32, None, False, "cuda"),
    Way("bfloat16 autocast, CUDA", torch.float32, torch.bfloat16, False, "cuda"),
    Way("float16 autocast, CUDA", torch.float32, torch.float16, False, "cuda", loss_scale=1024.0),
]


@dataclass
class Row:
    """A way's errors against float64. Gradients: relative L2 and largest error over largest gradient, per group.
    from_float64, from_truth: PSNR of the fitted albedo texture in dB, the latter after one gain per channel.
    failed: why there is no more."""

    name: str
    fields: float | None = None
    loss: float | None = None
    gradients: dict[str, tuple[float, float]] | None = None
    from_float64: float | None = None
    from_truth: float | None = None
    failed: str = ""


@dataclass(frozen=True)
class Step:
    """Albedo and irradiance (N, 6) of one batch, its loss, and gradients by group, all float64 on the CPU."""

    fields: torch.Tensor
    loss: float
    gradients: dict[str, torch.Tensor]


def main() -> None:
    options = parse()
    rows = measure(options.steps)
    facts = provenance()
    print(f"{step_table(rows)}\n\n{fit_table(rows)}\n")
    print(f"{options.steps} steps of {BATCH} samples. {sentence(facts)}")
    if options.json:
        print(json.dumps({"measured": facts, "steps": options.steps, "rows": [asdict(row) for row in rows]}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=200, help="of each fit")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def measure(steps: int, ways: list[Way] | None = None) -> list[Row]:
    """A row for float64 and for each of `ways`; by default all that this machine has."""
    if ways is None:
        ways = WAYS + (GPU_WAYS if torch.cuda.is_available() else [])
    torch.manual_seed(0)
    start = Model(SPEC, PHOTOS).double()
    fitted = fitted_from(start, EXACT, steps)
    exact_step, exact_texture = one_step(fitted, EXACT), texture(fitted, EXACT)
    truth, mask = srgb_from_linear(albedo_at(texel_centres())), np.ones((TEXTURE, TEXTURE), bool)
    rows = [Row(EXACT.name, from_truth=psnr_after_gain(exact_texture, truth, mask))]
    for way in ways:
        print(f"   {way.name}", file=sys.stderr, flush=True)
        row = Row(way.name)
        rows.append(row)
        try:
            if way.dtype != EXACT.dtype:
                compare(row, one_step(prepared(fitted, way), way), exact_step)
            own = texture(fitted_from(start, way, steps), way)
        except (RuntimeError, NotImplementedError, TypeError) as error:
            row.failed = str(error).strip().splitlines()[0]
            continue
        if not np.isfinite(own).all():
            row.failed = "the fit diverged"
            continue
        row.from_float64, row.from_truth = psnr(own, exact_texture, mask), psnr_after_gain(own, truth, mask)
    return rows


def prepared(model: Model, way: Way) -> Model:
    """A copy of a float64 model in the way's type, on its device."""
    own = copy.deepcopy(model)
    random = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for parameter in own.parameters():  # zeros stay zeros: at 0 the small-offset term has a corner
            noise = torch.randn(parameter.shape, generator=random, dtype=parameter.dtype)
            parameter *= 1.0 + way.moved * noise
    return own.to(way.device, way.dtype)


@contextlib.contextmanager
def computing(way: Way) -> Iterator[None]:
    """Have the product's own code compute in the given way."""

    def loss(*arguments: object) -> torch.Tensor:
        # entered for each step: autocast keeps its 16-bit copies of the weights until it is left
        with torch.autocast(way.device, way.autocast, enabled=way.autocast is not None):
            return way.loss_scale * model_loss(*arguments)  # type: ignore[arg-type]

    with contextlib.ExitStack() as patches:
        patches.enter_context(mock.patch.object(optimise, "model_loss", loss))
        if way.reference:
            patches.enter_context(mock.patch.object(fused, "computes", lambda *_: False))
        yield


def one_step(model: Model, way: Way) -> Step:
    """Fields, loss and gradients of one batch."""
    data = samples_for(way)
    samples = data.samples(next(optimise.batches(data.ranges, BATCH, seed=2)), torch.device(way.device))
    with computing(way):
        loss, found = optimise.step_for(model, TERMS, list(model.parameters()), 0.0).gradients(samples)
        with torch.no_grad():
            fields = torch.cat(
                [model.albedo(samples.uv), model.light(samples.position, samples.photo)], dim=1
            )
    parts: dict[str, list[torch.Tensor]] = {name: [] for name in CLUSTERS}
    for name, gradient in found.items():
        group = "tables" if name.endswith("tables") else "decoders" if ".decoder." in name else "photos"
        parts[group].append(torch.as_tensor(gradient).double().reshape(-1).cpu())
    gradients = {name: torch.cat(own) / way.loss_scale for name, own in parts.items()}
    return Step(fields.double().cpu(), float(loss) / way.loss_scale, gradients)


def compare(row: Row, step: Step, exact: Step) -> None:
    """Put a step's errors into its row."""
    row.fields = relative(step.fields, exact.fields)[0]
    row.loss = abs(step.loss - exact.loss) / exact.loss
    row.gradients = {name: relative(step.gradients[name], exact.gradients[name]) for name in CLUSTERS}


def relative(value: torch.Tensor, exact: torch.Tensor) -> tuple[float, float]:
    """Error in L2 over L2, and largest error over largest value."""
    error = value - exact
    return float(error.norm() / exact.norm()), float(error.abs().max() / exact.abs().max())


def fitted_from(start: Model, way: Way, steps: int) -> Model:
    """A copy of `start`, fitted in the given way."""
    model = prepared(start, way)
    data = samples_for(way)
    schedule = Schedule(steps, BATCH, learning_rate=1e-2)
    with computing(way):
        fit(model, data, data.ranges, TERMS, schedule, way.seed, lambda *_: None)  # type: ignore[arg-type]
    return model


def samples_for(way: Way) -> SphereSamples:
    """The problem's samples, in float64 for who computes in it, else in float32 as the ray cache gives them."""
    return SphereSamples(
        PHOTOS, SAMPLES_PER_PHOTO, EXACT.dtype if way.dtype == EXACT.dtype else torch.float32
    )


@torch.no_grad()
def texture(model: Model, way: Way) -> np.ndarray:
    """(TEXTURE, TEXTURE, 3) sRGB albedo in [0, 1], float64; without autocast, as the bake."""
    uv = torch.from_numpy(texel_centres().reshape(-1, 2)).to(model.offset.device)
    with computing(way):
        albedo = model.albedo(uv)
    linear = albedo.double().cpu().numpy().reshape(TEXTURE, TEXTURE, 3)
    return srgb_from_linear(linear.clip(0.0, 1.0))


def psnr_after_gain(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR in dB after one gain per channel, which photos alone leave open."""
    return psnr(apply_gains(picture, gains(picture, truth, mask)), truth, mask)


def texel_centres() -> np.ndarray:
    """(TEXTURE, TEXTURE, 2) texture coordinates, top row first."""
    centre = (np.arange(TEXTURE) + 0.5) / TEXTURE
    return np.stack(np.meshgrid(centre, 1.0 - centre), axis=-1)


def step_table(rows: list[Row]) -> str:
    """Errors of one step as a Markdown table; gradients as L2 / largest."""
    lines = [
        f"| one step against float64 | fields | loss | {' | '.join(f'gradient of {name}' for name in CLUSTERS)} |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        if row.gradients is not None:
            pairs = [f"{row.gradients[name][0]:.1e} / {row.gradients[name][1]:.1e}" for name in CLUSTERS]
            lines.append(f"| {row.name} | {row.fields:.1e} | {row.loss:.1e} | {' | '.join(pairs)} |")
    return "\n".join(lines)


def fit_table(rows: list[Row]) -> str:
    """The fitted textures as a Markdown table."""
    lines = ["| fit | PSNR against the float64 fit | PSNR against the truth, after gain |", "|---|---:|---:|"]
    for row in rows:
        to_exact = "" if row.from_float64 is None else f"{row.from_float64:.2f}"
        to_truth = row.failed if row.from_truth is None else f"{row.from_truth:.2f}"
        lines.append(f"| {row.name} | {to_exact} | {to_truth} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
