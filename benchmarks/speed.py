"""Speed of a step of the fit: `python3 dev.py bench speed [--preset standard] [--rounds N] [--json]`.

A whole step of the preset's model (both encodings, decoders, loss without priors, gradients, Adam) on the CPU by plain torch and
by the product's numba path, then the parts of either. All take turns in one run, on one batch of a synthetic scene, and
medians count: so others' work on the machine slows all alike. Needs no data. Prints Markdown tables.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from dante_w.jit import njit_fast
from dante_w.model import fused
from dante_w.model.fields import Model
from dante_w.model.fused import FusedStep
from dante_w.model.kernels import BLOCK
from dante_w.model.kernels.decoder import Decoder, decode, decode_backward
from dante_w.model.kernels.grid import encode, load, scatter
from dante_w.model.kernels.loss import Shown, Weights, loss_backward
from dante_w.model.optimise import RUN, LossTerms, TorchStep, model_loss
from dante_w.model.presets import PRESETS, SMALL_OFFSET, WHITE_LIGHT
from dante_w.rays.ray_cache import Samples
from measure.machine import provenance, sentence

TERMS = LossTerms(white_light=WHITE_LIGHT, small_offset=SMALL_OFFSET)
PHOTOS = 40
TORCH, NUMBA = "plain torch gather", "numba"
STAGES = ("encode 2D", "encode 3D", "decoders", "loss", "backward", "optimiser")
#: Texture coordinates between neighbouring pixels, as on the shared scenes: four texels of 2048.
SPACING = 4.0 / 2048.0

Work = Callable[[], object]


def main() -> None:
    options = parse()
    torch.manual_seed(0)
    preset = PRESETS[options.preset]
    batch = options.batch or preset.schedule.batch
    model = Model(preset.model, PHOTOS)
    samples = batch_of(batch)
    steps = measure(whole_steps(model, samples), options.rounds)
    stages = {
        path: measure(of(model, samples), options.rounds)
        for path, of in ((TORCH, torch_stages), (NUMBA, numba_stages))
    }
    ratio = steps[TORCH] / steps[NUMBA]
    facts = provenance()
    print(table(options.preset, batch, steps, stages))
    print(f"\nA whole step is {ratio:.0f} times as fast. {sentence(facts)}")
    if options.json:
        content = {
            "measured": facts,
            "preset": options.preset,
            "batch": batch,
            "rounds": options.rounds,
            "full_step_ratio": ratio,
            "samples_per_second": {path: batch / seconds for path, seconds in steps.items()},
            "stage_samples_per_second": {
                path: {name: batch / seconds for name, seconds in own.items()} for path, own in stages.items()
            },
            "profile_seconds": stages,
        }
        print(json.dumps(content))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--preset", default="standard", choices=list(PRESETS))
    parser.add_argument("--batch", type=int, help="samples a step; the preset's by default")
    parser.add_argument("--rounds", type=int, default=5, help="how often each thing is timed")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def measure(works: dict[str, Work], rounds: int) -> dict[str, float]:
    """Median seconds of each of `works`, which take turns; once before without a clock."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(rounds + 1):
        for name, work in works.items():
            print(f"\r   round {turn} of {rounds}: {name:20}", end="", file=sys.stderr, flush=True)
            began = time.perf_counter()
            work()
            if turn > 0:
                seconds[name].append(time.perf_counter() - began)
    print(file=sys.stderr)
    return {name: statistics.median(own) for name, own in seconds.items()}


def batch_of(count: int) -> Samples:
    """Random samples as the fit draws them, in runs of neighbours in a photo's row."""
    random = torch.Generator().manual_seed(0)
    runs = -(-count // RUN)
    along = torch.arange(RUN)[:, None] * torch.tensor([SPACING, 0.0, 0.0])
    position = (torch.rand(runs, 1, 3, generator=random) + along).clamp(0.0, 1.0).reshape(-1, 3)[:count]
    photo = torch.randint(0, PHOTOS, (runs,), generator=random).repeat_interleave(RUN)[:count]
    colour = torch.rand(count, 3, generator=random)
    return Samples(
        photo, position[:, :2].contiguous(), position, colour, None, torch.rand(count, generator=random)
    )


def whole_steps(model: Model, samples: Samples) -> dict[str, Work]:
    """A whole step on either path."""

    def step(way: TorchStep | FusedStep) -> None:
        way.gradients(samples)
        way.update(1.0)

    ways = {TORCH: TorchStep, NUMBA: FusedStep}
    return {
        path: partial(step, way(model, TERMS, list(model.parameters()), 1e-3)) for path, way in ways.items()
    }


def torch_stages(model: Model, samples: Samples) -> dict[str, Work]:
    """The parts of a step in plain torch; `loss` is without gradients, `backward` is all of them."""
    fields = model.albedo, model.irradiance
    with torch.no_grad():
        inputs, raw = decoder_inputs(model, samples)
    known = _Known(model, raw)
    parameters = list(model.parameters())
    loss = model_loss(model, samples, TERMS)
    for parameter, gradient in zip(
        parameters, torch.autograd.grad(loss, parameters, retain_graph=True), strict=True
    ):
        parameter.grad = gradient
    optimiser = torch.optim.Adam(parameters, lr=1e-3, fused=True)
    return {
        "encode 2D": partial(model.albedo.grid, samples.uv),
        "encode 3D": partial(model.irradiance.grid, samples.position),
        "decoders": lambda: [field.decoder(x) for field, x in zip(fields, inputs, strict=True)],
        "loss": lambda: model_loss(known, samples, TERMS),  # type: ignore[arg-type]
        "backward": lambda: torch.autograd.grad(loss, parameters, retain_graph=True),
        "optimiser": optimiser.step,
    }


def decoder_inputs(model: Model, samples: Samples) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """What goes into either decoder (N, K), and what comes out (N, 3)."""
    light = torch.cat([model.irradiance.grid(samples.position), model.embedding[samples.photo]], dim=1)
    inputs = [model.albedo.grid(samples.uv), light]
    return inputs, [model.albedo.decoder(inputs[0]), model.irradiance.decoder(inputs[1])]


class _Known:
    """A model whose decoders' values (N, 3) are known."""

    def __init__(self, model: Model, raw: list[torch.Tensor]) -> None:
        self.offset, self.expose = model.offset, model.expose
        self._albedo, self._light = raw

    def albedo(self, _: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(self._albedo)

    def light(self, *_: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.softplus(self._light)


def numba_stages(model: Model, samples: Samples) -> dict[str, Work]:
    """The same parts by the product's kernels; within a step they pass blocks on in the cache, so they add up to more."""
    fields, count = (model.albedo, model.irradiance), len(samples.uv)
    grids, decoders = (
        [of(part) for part in parts]
        for of, parts in (
            (fused.grid_of, (field.grid for field in fields)),
            (fused.decoder_of, (field.decoder for field in fields)),
        )
    )
    points = samples.uv.numpy(), samples.position.numpy()
    pieces = fused.pieces_of(count, fused.PIECE)
    rows = np.random.default_rng(0).normal(0.0, 1e-6, (-(-count // BLOCK), 64, BLOCK)).astype(np.float32)
    gradients = [np.zeros_like(grid.tables) for grid in grids]
    step = FusedStep(model, TERMS, list(model.parameters()), 1e-3)
    step.gradients(samples)

    def each(kernel: Callable[..., None], *arguments: object) -> None:
        fused.run(partial(kernel, *arguments, first, end) for first, end in pieces)

    def backward() -> None:
        for decoder in decoders:
            each(_backward, decoder)
        fused.run(
            partial(scatter, xyz, resolution, grid.shift, rows, 0, gradient[start:end])
            for grid, xyz, gradient in zip(grids, points, gradients, strict=True)
            for resolution, start, end in zip(grid.resolutions, grid.offsets, grid.offsets[1:], strict=False)
        )

    return {
        "encode 2D": partial(each, _encode, grids[0], points[0]),
        "encode 3D": partial(each, _encode, grids[1], points[1]),
        "decoders": lambda: [each(_decode, decoder) for decoder in decoders],
        "loss": partial(each, _loss, Weights(*map(np.float32, (1e-5, 1e-6, 1e-6, 0.0, fused.DARKNESS)))),
        "backward": backward,
        "optimiser": _refilled(step),
    }


def _refilled(step: FusedStep) -> Work:
    """Adam on the same gradients each time; it clears them as it goes."""
    state = list(step._state.values())
    kept = [moments.gradient.copy() for moments in state]

    def update() -> None:
        for moments, gradient in zip(state, kept, strict=True):
            np.copyto(moments.gradient, gradient)
        step.update(1.0)

    return update


@njit_fast
def _encode(grid, points, first, end):  # type: ignore[no-untyped-def]
    dimensions = points.shape[1]
    block = np.empty((dimensions, BLOCK), np.float32)
    entry, weight = np.empty((8, BLOCK), np.uint32), np.empty((8, BLOCK), np.float32)
    encoded = np.empty((len(grid.resolutions) * grid.tables.shape[1], BLOCK), np.float32)
    for start in range(first, end, BLOCK):
        load(points, start, block)
        encode(grid, block, entry, weight, encoded)


@njit_fast
def _decode(decoder, first, end):  # type: ignore[no-untyped-def]
    x = np.full((decoder.w1.shape[1], BLOCK), np.float32(0.5))
    hidden, out = np.empty((len(decoder.b1), BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
    for _ in range(first, end, BLOCK):
        decode(decoder, x, hidden, out)


@njit_fast
def _backward(decoder, first, end):  # type: ignore[no-untyped-def]
    x = np.full((decoder.w1.shape[1], BLOCK), np.float32(0.5))
    hidden = np.full((len(decoder.b1), BLOCK), np.float32(0.5))
    upstream, d_hidden, d_x = np.full((3, BLOCK), np.float32(0.5)), np.empty_like(hidden), np.empty_like(x)
    gradient = Decoder(
        np.zeros_like(decoder.w1),
        np.zeros_like(decoder.b1),
        np.zeros_like(decoder.w2),
        np.zeros_like(decoder.b2),
    )
    for _ in range(first, end, BLOCK):
        decode_backward(decoder, x, hidden, upstream, d_hidden, d_x, gradient)


@njit_fast
def _loss(weights, first, end):  # type: ignore[no-untyped-def]
    half = np.full((3, BLOCK), np.float32(0.5))
    albedo, light, scratch, d_exposure, d_offset = (
        half.copy(),
        half.copy(),
        half.copy(),
        half.copy(),
        half.copy(),
    )
    shown = Shown(half, half, half, half, np.ones(BLOCK, np.float32))
    for _ in range(first, end, BLOCK):
        loss_backward(albedo, light, shown, weights, scratch, d_exposure, d_offset)


def table(preset: str, batch: int, steps: dict[str, float], stages: dict[str, dict[str, float]]) -> str:
    """Milliseconds and M samples/s of the whole step and its parts, on either path."""
    lines = [
        f"| `{preset}`, {batch:,} samples | {TORCH}, ms | M samples/s | {NUMBA}, ms | M samples/s | ratio |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    rows = {"**whole step**": steps} | {
        name: {path: own[name] for path, own in stages.items()} for name in STAGES
    }
    for name, seconds in rows.items():
        slow, fast = seconds[TORCH], seconds[NUMBA]
        cells = [
            f"{1e3 * slow:.1f}",
            f"{batch / slow / 1e6:.3f}",
            f"{1e3 * fast:.1f}",
            f"{batch / fast / 1e6:.2f}",
        ]
        lines.append(f"| {name} | {' | '.join(cells)} | {slow / fast:.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
