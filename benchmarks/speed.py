"""Speed of a step of the fit: `python3 dev.py bench speed [--device cpu|cuda] [--preset NAME] [--rounds N] [--together N] [--json]`.

A whole step of the paper's model (both encodings, decoders, loss without priors, gradients, Adam) by plain torch and by the
product's own engine on that device: numba on the CPU, Triton on CUDA. The two take turns of --together steps in one
run, through the same batches of a synthetic scene, and medians count; so other work on the machine slows both alike.
On CUDA also the preset with albedo to 8192, GPU memory, and a profile by kernel. Needs no data. Prints Markdown tables.
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
from dante_w.field.optimise import LossTerms, Step, TorchStep
from dante_w.field.presets import PRESETS, SMALL_OFFSET, WHITE_LIGHT
from dante_w.rays.ray_cache import Samples
from dante_w.run.device import failure
from measure.machine import provenance, sentence
from measure.turns import median_seconds

TERMS = LossTerms(white_light=WHITE_LIGHT, small_offset=SMALL_OFFSET)
PHOTOS = 40
TORCH, NUMBA, TRITON = "plain torch", "numba", "triton"
#: Texture coordinates between neighbouring pixels, as on the shared scenes: four texels of 2048.
SPACING = 4.0 / 2048.0
#: Steps that are timed together. The ratio depends on it: the step after the other engine's is slower, and on a GPU a step does
#: not wait for the one before.
TOGETHER = 20
#: Batches that steps go through.
BATCHES = 8
#: Texels a side of the finest albedo level of a scene, in the paper.
FINE = 8192
#: Steps of which GPU memory and profile are taken, after as many that only warm up, and kernels in the profile.
PROFILED, KERNELS = 5, 15

Engine = Callable[..., Step]


def main() -> None:
    options = parse()
    facts = provenance()
    reason = (failure("cuda") or triton_grid.failure()) if options.device == "cuda" else None
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
        setting = {"device": options.device, "rounds": options.rounds, "together": options.together}
        print(json.dumps({"measured": facts, **setting, **content}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--preset", choices=list(PRESETS), help="default: standard, on CUDA paper")
    parser.add_argument("--batch", type=int, help="samples a step; the preset's by default")
    parser.add_argument("--rounds", type=int, default=5, help="how often each thing is timed")
    parser.add_argument("--together", type=int, default=TOGETHER, help="steps of either engine in a turn")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args()


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
            name: peak_bytes(engine, spec, samples)
            for name, engine in ((TORCH, TorchStep), (TRITON, TritonStep))
        }
        print(table(f"`{name}`, albedo to {finest}", content))
        peaks = (f"{name} {size / 1e9:.2f} GB" for name, size in content["peak_gpu_bytes"].items())
        print(f"\nGPU memory at most: {', '.join(peaks)}.\n")
        print(profile(Model(spec, PHOTOS).to("cuda"), samples))
        found[str(finest)] = content
    first = next(iter(found.values()))
    return {"preset": name, "full_step_ratio": first["full_step_ratio"], "finest": found}


def compare(
    spec: ModelSpec, batches: list[Samples], options: argparse.Namespace, name: str, engine: Engine
) -> dict[str, Any]:
    """Seconds and samples per second of whole steps by plain torch and by the engine called `name`."""
    device, batch, together = batches[0].uv.device.type, len(batches[0].uv), options.together
    torch.manual_seed(0)
    model = Model(spec, PHOTOS).to(device)
    works = whole_steps(model, batches, {TORCH: TorchStep, name: engine}, together)
    seconds = {each: s / together for each, s in median_seconds(works, options.rounds, device).items()}
    return {
        "batch": batch,
        "full_step_ratio": seconds[TORCH] / seconds[name],
        "step_seconds": seconds,
        "samples_per_second": {each: batch / s for each, s in seconds.items()},
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
    model: Model, batches: list[Samples], engines: dict[str, Engine], together: int
) -> dict[str, Callable[[], object]]:
    """`together` whole steps by each of `engines`."""

    def steps(step: Step) -> None:
        for turn in range(together):
            step.gradients(batches[turn % len(batches)])
            step.update(1.0)

    return {name: partial(steps, _start(engine, model)) for name, engine in engines.items()}


def peak_bytes(engine: Engine, spec: ModelSpec, samples: Samples) -> int:
    """The most GPU memory that a new model and its fit take in a few steps; the batch is not counted."""
    device = samples.uv.device
    before = torch.cuda.memory_allocated(device)
    step = _start(engine, Model(spec, PHOTOS).to(device))
    for turn in range(2 * PROFILED):
        if turn == PROFILED:
            torch.cuda.reset_peak_memory_stats(device)
        step.gradients(samples)
        step.update(1.0)
    return torch.cuda.max_memory_allocated(device) - before


def profile(model: Model, samples: Samples) -> str:
    """Which kernels a step by Triton spends its time in: torch's own table."""
    step = _start(TritonStep, model)
    for _ in range(PROFILED):
        step.gradients(samples)
        step.update(1.0)
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as seen:
        for _ in range(PROFILED):
            step.gradients(samples)
            step.update(1.0)
        torch.cuda.synchronize()
    by_time = seen.key_averages()
    return by_time.table(sort_by="self_device_time_total", row_limit=KERNELS, max_name_column_width=60)


def _start(engine: Engine, model: Model) -> Step:
    return engine(model, TERMS, list(model.parameters()), 1e-3)


def table(title: str, content: dict[str, Any]) -> str:
    """Milliseconds and M samples/s of a whole step by either engine."""
    batch, seconds = content["batch"], content["step_seconds"]
    slow, fast = seconds
    cells = (f"{1e3 * each:.1f} | {batch / each / 1e6:.2f}" for each in seconds.values())
    return "\n".join(
        [
            f"| {title}, {batch:,} samples | {slow}, ms | M samples/s | {fast}, ms | M samples/s | ratio |",
            "|---|---:|---:|---:|---:|---:|",
            f"| whole step | {' | '.join(cells)} | {seconds[slow] / seconds[fast]:.1f} |",
        ]
    )


if __name__ == "__main__":
    main()
