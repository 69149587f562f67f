"""Speed of a step of the fit: `python3 dev.py bench speed [--device cpu|cuda] [--preset NAME] [--rounds N] [--together N] [--json]`.

A whole step of the paper's model (both encodings, decoders, loss without priors, gradients, Adam) by plain torch and by the
product's own engine on that device: numba on the CPU, Triton on CUDA. The two take turns of --together steps in one
run, through the same batches of a synthetic scene, and medians count; so other work on the machine slows both alike.
On CUDA also the preset with albedo to 8192, GPU memory, and a profile by kernel. Needs no data. Prints Markdown tables.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from dante_w.field.batches import DRAWING
from dante_w.field.cpu.step import CpuStep
from dante_w.field.cuda import grid as cuda_grid
from dante_w.field.cuda.step import CudaStep
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.settings import STANDARD
from dante_w.field.step import Step, TorchStep
from dante_w.presets import PRESETS, Preset
from dante_w.rays.ray_cache import Samples
from dante_w.run.device import failure
from measure.machine import provenance, sentence
from measure.turns import median_seconds

TERMS = STANDARD.terms(prior_weight=1.0, priors=False)
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


def main(arguments: Sequence[str] | None = None, presets: Mapping[str, Preset] = PRESETS) -> None:
    options = parse(arguments)
    facts = provenance()
    reason = (failure("cuda") or cuda_grid.failure()) if options.device == "cuda" else None
    if reason:
        print(f"--device {options.device} could not be run here: {reason}.")
        content: dict[str, Any] = {"could_not_be_run": reason}
    elif options.device == "cuda":
        content = on_cuda(options, presets)
    else:
        field = presets[options.preset or "standard"].field
        batches = batches_of(options.batch or field.schedule.batch, "cpu")
        content = compare(field.model, batches, options, NUMBA, CpuStep)
        print(table(f"`{options.preset or 'standard'}`", content))
    if "full_step_ratio" in content:
        print(f"\nA whole step is {content['full_step_ratio']:.1f} times as fast. {sentence(facts)}")
    if options.json:
        setting = {"device": options.device, "rounds": options.rounds, "together": options.together}
        print(json.dumps({"measured": facts, **setting, **content}))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--preset", choices=list(PRESETS), help="default: standard, on CUDA paper")
    parser.add_argument("--batch", type=int, help="samples a step; the preset's by default")
    parser.add_argument("--rounds", type=int, default=5, help="how often each thing is timed")
    parser.add_argument("--together", type=int, default=TOGETHER, help="steps of either engine in a turn")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    return parser.parse_args(arguments)


def on_cuda(options: argparse.Namespace, presets: Mapping[str, Preset]) -> dict[str, Any]:
    """Times, GPU memory and profile of a preset's model, and of the same with albedo to `FINE`."""
    name = options.preset or "paper"
    field = presets[name].field
    batches = batches_of(options.batch or field.schedule.batch, "cuda")
    samples, found = batches[0], {}
    for finest in (field.model.albedo.finest, FINE):
        spec = replace(field.model, albedo=replace(field.model.albedo, finest=finest))
        content = compare(spec, batches, options, TRITON, CudaStep)
        content["peak_gpu_bytes"] = {
            each: peak_bytes(engine, spec, samples)
            for each, engine in ((TORCH, TorchStep), (TRITON, CudaStep))
        }
        print(table(f"`{name}`, albedo to {finest}", content))
        peaks = (f"{each} {size / 1e9:.2f} GB" for each, size in content["peak_gpu_bytes"].items())
        print(f"\nGPU memory at most: {', '.join(peaks)}.\n")
        print(profile(FieldModel(spec, PHOTOS).to("cuda"), samples))
        found[str(finest)] = content
    first = next(iter(found.values()))
    return {"preset": name, "full_step_ratio": first["full_step_ratio"], "finest": found}


def compare(
    spec: FieldSpec, batches: list[Samples], options: argparse.Namespace, name: str, engine: Engine
) -> dict[str, Any]:
    """Seconds and samples per second of whole steps by plain torch and by the engine called `name`."""
    device, batch, together = batches[0].uv.device.type, len(batches[0].uv), options.together
    torch.manual_seed(0)
    model = FieldModel(spec, PHOTOS).to(device)
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
    runs = -(-count // DRAWING.run)
    along = torch.arange(DRAWING.run)[:, None] * torch.tensor([SPACING, 0.0, 0.0])
    position = (torch.rand(runs, 1, 3, generator=random) + along).clamp(0.0, 1.0).reshape(-1, 3)[:count]
    photo = torch.randint(0, PHOTOS, (runs,), generator=random).repeat_interleave(DRAWING.run)[:count]
    colour = torch.rand(count, 3, generator=random)
    weight = torch.rand(count, generator=random)
    fields = photo, position[:, :2].contiguous(), position, colour
    return Samples(*(field.to(device) for field in fields), None, weight.to(device))


def whole_steps(
    model: FieldModel, batches: list[Samples], engines: dict[str, Engine], together: int
) -> dict[str, Callable[[], object]]:
    """`together` whole steps by each of `engines`."""

    def steps(step: Step) -> None:
        for turn in range(together):
            step.gradients(batches[turn % len(batches)])
            step.update(1.0)

    return {name: partial(steps, _start(engine, model)) for name, engine in engines.items()}


def peak_bytes(engine: Engine, spec: FieldSpec, samples: Samples) -> int:
    """The most GPU memory that a new model and its fit take in a few steps; the batch is not counted."""
    device = samples.uv.device
    before = torch.cuda.memory_allocated(device)
    step = _start(engine, FieldModel(spec, PHOTOS).to(device))
    for turn in range(2 * PROFILED):
        if turn == PROFILED:
            torch.cuda.reset_peak_memory_stats(device)
        step.gradients(samples)
        step.update(1.0)
    return torch.cuda.max_memory_allocated(device) - before


def profile(model: FieldModel, samples: Samples) -> str:
    """Which kernels a step by Triton spends its time in: torch's own table."""
    step = _start(CudaStep, model)
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


def _start(engine: Engine, model: FieldModel) -> Step:
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
