"""Speed of a step of the fit: `python3 dev.py bench speed [--device cpu|cuda] [--preset NAME] [--rounds N] [--together N] [--json]`.

A whole step of the preset's model (both encodings, decoders, loss without priors, gradients, Adam) by plain torch and by the product's
own path on that device, numba on the CPU and Triton on CUDA, then the parts of either. Both paths take turns of --together steps in one run,
through the same batches of a synthetic scene, as a fit goes through its own, parts turns of one; medians count: so others' work on
the machine slows all alike. On CUDA, the preset `paper` as
it is and with albedo to 8192, GPU memory, and a profile by kernel. Needs no data. Prints Markdown tables.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from dante_w.field.batches import RUN
from dante_w.field.cpu.step import FusedStep
from dante_w.field.cuda import grid as triton_grid
from dante_w.field.cuda.step import TritonStep
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.optimise import LossTerms, Step, TorchStep, model_loss
from dante_w.field.presets import PRESETS, SMALL_OFFSET, WHITE_LIGHT
from dante_w.rays.ray_cache import Samples
from dante_w.run.device import failure
from measure.cuda_stages import peak_bytes, profile, triton_stages
from measure.machine import provenance, sentence
from measure.numba_stages import numba_stages
from measure.stages import Stage, measure

TERMS = LossTerms(white_light=WHITE_LIGHT, small_offset=SMALL_OFFSET)
PHOTOS = 40
TORCH, NUMBA, TRITON = "plain torch gather", "numba", "triton"
STAGES = ("encode 2D", "encode 3D", "decoders", "loss", "backward", "optimiser")
#: Texture coordinates between neighbouring pixels, as on the shared scenes: four texels of 2048.
SPACING = 4.0 / 2048.0
#: Steps that are timed together. The ratio depends on it (docs/benchmarks.md): the step that comes after the other path's is slower; on a GPU
#: a step does not wait for the one before.
TOGETHER = 20
#: Batches that steps go through.
BATCHES = 8
#: Texels a side of the finest albedo level of a scene, in the paper.
FINE = 8192

Way = Callable[..., Step]


def main() -> None:
    options = parse()
    facts = provenance()
    reason = why_not(options.device)
    if reason:
        print(f"--device {options.device} could not be run here: {reason}.")
        content: dict[str, Any] = {"could_not_be_run": reason}
    elif options.device == "cuda":
        content = on_cuda(options)
    else:
        preset = PRESETS[options.preset or "standard"]
        batches = batches_of(options.batch or preset.schedule.batch, "cpu")
        content = compare(preset.model, batches, options, NUMBA, FusedStep)
        print(table(f"`{options.preset or 'standard'}`", content))
    if "full_step_ratio" in content:
        print(f"\nA whole step is {content['full_step_ratio']:.1f} times as fast. {sentence(facts)}")
    if options.json:
        print(
            json.dumps(
                {
                    "measured": facts,
                    "device": options.device,
                    "rounds": options.rounds,
                    "together": options.together,
                    **content,
                }
            )
        )


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--preset", choices=list(PRESETS), help="default: standard, on CUDA paper")
    parser.add_argument("--batch", type=int, help="samples a step; the preset's by default")
    parser.add_argument("--rounds", type=int, default=5, help="how often each thing is timed")
    parser.add_argument("--together", type=int, default=TOGETHER, help="steps of either path in a turn")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


def why_not(device: str) -> str | None:
    """Why the paths of a device cannot be timed, or None."""
    return (failure("cuda") or triton_grid.failure()) if device == "cuda" else None


def on_cuda(options: argparse.Namespace) -> dict[str, Any]:
    """Times, GPU memory and profile of a preset's model, and of the same with albedo to `FINE`."""
    name = options.preset or "paper"
    preset = PRESETS[name]
    batches = batches_of(options.batch or preset.schedule.batch, "cuda")
    samples, found = batches[0], {}
    for finest in (preset.model.albedo.finest, FINE):
        spec = replace(preset.model, albedo=replace(preset.model.albedo, finest=finest))
        content = compare(spec, batches, options, TRITON, TritonStep)
        content["peak_gpu_bytes"] = {
            path: peak_bytes(way, spec, PHOTOS, samples, TERMS)
            for path, way in ((TORCH, TorchStep), (TRITON, TritonStep))
        }
        print(table(f"`{name}`, albedo to {finest}", content))
        peaks = (f"{path} {size / 1e9:.2f} GB" for path, size in content["peak_gpu_bytes"].items())
        print(f"\nGPU memory at most: {', '.join(peaks)}.\n")
        print(profile(TritonStep, Model(spec, PHOTOS).to("cuda"), samples, TERMS))
        found[str(finest)] = content
    first = next(iter(found.values()))
    return {"preset": name, "full_step_ratio": first["full_step_ratio"], "finest": found}


def compare(
    spec: ModelSpec, batches: list[Samples], options: argparse.Namespace, own: str, way: Way
) -> dict[str, Any]:
    """Seconds and samples per second of whole steps and their parts, by plain torch and by the path called `own`."""
    samples, rounds, together = batches[0], options.rounds, options.together
    device, batch = samples.uv.device.type, len(samples.uv)
    torch.manual_seed(0)
    model = Model(spec, PHOTOS).to(device)
    steps = measure(whole_steps(model, batches, {TORCH: TorchStep, own: way}, together), rounds, device)
    steps = {path: seconds / together for path, seconds in steps.items()}
    plain = torch_stages(model, samples)
    parts = numba_stages(model, samples) if own == NUMBA else triton_stages(model, samples, TERMS, plain)
    stages = {path: measure(each, rounds, device) for path, each in ((TORCH, plain), (own, parts))}
    return {
        "batch": batch,
        "full_step_ratio": steps[TORCH] / steps[own],
        "step_seconds": steps,
        "samples_per_second": {path: batch / seconds for path, seconds in steps.items()},
        "stage_samples_per_second": {
            path: {name: batch / seconds for name, seconds in each.items()} for path, each in stages.items()
        },
        "profile_seconds": stages,
    }


def batches_of(count: int, device: str) -> list[Samples]:
    """`BATCHES` batches of `count` samples."""
    return [batch_of(count, device, seed) for seed in range(BATCHES)]


def batch_of(count: int, device: str = "cpu", seed: int = 0) -> Samples:
    """Random samples as the fit draws them, in runs of neighbours in a photo's row."""
    random = torch.Generator().manual_seed(seed)
    runs = -(-count // RUN)
    along = torch.arange(RUN)[:, None] * torch.tensor([SPACING, 0.0, 0.0])
    position = (torch.rand(runs, 1, 3, generator=random) + along).clamp(0.0, 1.0).reshape(-1, 3)[:count]
    photo = torch.randint(0, PHOTOS, (runs,), generator=random).repeat_interleave(RUN)[:count]
    colour = torch.rand(count, 3, generator=random)
    weight = torch.rand(count, generator=random)
    fields = photo, position[:, :2].contiguous(), position, colour
    return Samples(*(field.to(device) for field in fields), None, weight.to(device))


def whole_steps(
    model: Model, batches: list[Samples], ways: dict[str, Way], together: int
) -> dict[str, Stage]:
    """`together` whole steps by each of `ways`."""

    def steps(way: Step) -> None:
        for turn in range(together):
            way.gradients(batches[turn % len(batches)])
            way.update(1.0)

    parameters = list(model.parameters())
    return {path: Stage(partial(steps, way(model, TERMS, parameters, 1e-3))) for path, way in ways.items()}


def torch_stages(model: Model, samples: Samples) -> dict[str, Stage]:
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
    works: dict[str, Callable[[], object]] = {
        "encode 2D": partial(model.albedo.grid, samples.uv),
        "encode 3D": partial(model.irradiance.grid, samples.position),
        "decoders": lambda: [field.decoder(x) for field, x in zip(fields, inputs, strict=True)],
        "loss": lambda: model_loss(known, samples, TERMS),  # type: ignore[arg-type]
        "backward": lambda: torch.autograd.grad(loss, parameters, retain_graph=True),
        "optimiser": optimiser.step,
    }
    return {name: Stage(work) for name, work in works.items()}


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


def table(title: str, content: dict[str, Any]) -> str:
    """Milliseconds and M samples/s of the whole step and its parts, on either path."""
    batch, steps, stages = content["batch"], content["step_seconds"], content["profile_seconds"]
    slow, own = steps
    lines = [
        f"| {title}, {batch:,} samples | {slow}, ms | M samples/s | {own}, ms | M samples/s | ratio |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    rows = {"**whole step**": steps} | {
        name: {path: each[name] for path, each in stages.items()} for name in STAGES
    }
    for name, seconds in rows.items():
        cells = (f"{1e3 * each:.1f} | {batch / each / 1e6:.2f}" for each in seconds.values())
        lines.append(f"| {name} | {' | '.join(cells)} | {seconds[slow] / seconds[own]:.1f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
