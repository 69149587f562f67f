"""The parts of a step of the fit by the product's kernels for CUDA, each for itself; memory and profile of whole steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from dante_w.field.cuda import grid as triton_grid
from dante_w.field.cuda.step import TritonStep
from dante_w.field.fields import Model, ModelSpec
from dante_w.field.optimise import LossTerms, Step
from dante_w.rays.ray_cache import Samples
from measure.stages import Stage

#: Steps of which memory and profile are taken, after as many that only warm up.
STEPS = 5
KERNELS = 15


def triton_stages(
    model: Model, samples: Samples, terms: LossTerms, torch_stages: dict[str, Stage]
) -> dict[str, Stage]:
    """Decoders and loss are plain torch's here too; `backward` is that of the decoders, and the sums in the
    tables."""
    grids = model.albedo.grid, model.irradiance.grid
    points = samples.uv, samples.position
    upstream = [torch.randn(len(samples.uv), grid.spec.width, device=samples.uv.device) for grid in grids]
    groups = [triton_grid.groups_of(grid.spec) for grid in grids]
    longest = max(
        group.entries * grid.spec.features for grid, own in zip(grids, groups, strict=True) for group in own
    )
    buffer = torch.zeros(longest, device=samples.uv.device)
    step, others = (
        TritonStep(model, terms, list(model.parameters()), 1e-3),
        [p for name, p in model.named_parameters() if not name.endswith("grid.tables")],
    )
    step.gradients(samples)
    encoded = [
        triton_grid.encode(xyz, grid.tables.detach(), grid.spec).requires_grad_()
        for grid, xyz in zip(grids, points, strict=True)
    ]
    light = model.irradiance.of_encoded(encoded[1], model.embedding[samples.photo])
    product = (model.albedo.of_encoded(encoded[0]) * light).mean()
    wanted = [*encoded, *others]

    def backward() -> None:
        torch.autograd.grad(product, wanted, retain_graph=True, allow_unused=True)
        for grid, xyz, own, slope in zip(grids, points, groups, upstream, strict=True):
            for group in own:
                triton_grid.scatter(xyz, slope, grid.spec, group, buffer)

    def encode(which: int) -> torch.Tensor:
        return triton_grid.encode(points[which], grids[which].tables, grids[which].spec)

    return {
        "encode 2D": Stage(partial(encode, 0)),
        "encode 3D": Stage(partial(encode, 1)),
        "decoders": torch_stages["decoders"],
        "loss": torch_stages["loss"],
        "backward": Stage(backward),
        "optimiser": Stage(partial(step.update, 1.0), before=partial(step.gradients, samples)),
    }


def peak_bytes(
    way: Callable[..., Step], spec: ModelSpec, photos: int, samples: Samples, terms: LossTerms
) -> int:
    """The most GPU memory that a new model and its fit take in a few steps; the batch is not counted."""
    device = samples.uv.device
    before = torch.cuda.memory_allocated(device)
    model = Model(spec, photos).to(device)
    step = way(model, terms, list(model.parameters()), 1e-3)
    for turn in range(2 * STEPS):
        if turn == STEPS:
            torch.cuda.reset_peak_memory_stats(device)
        step.gradients(samples)
        step.update(1.0)
    return torch.cuda.max_memory_allocated(device) - before


def profile(way: Callable[..., Step], model: Model, samples: Samples, terms: LossTerms) -> str:
    """Which kernels a step spends its time in: torch's own table."""
    step = way(model, terms, list(model.parameters()), 1e-3)
    activities = [torch.profiler.ProfilerActivity.CPU]
    on_gpu = samples.uv.device.type == "cuda"
    if on_gpu:
        activities.append(torch.profiler.ProfilerActivity.CUDA)
    for _ in range(STEPS):
        step.gradients(samples)
        step.update(1.0)
    with torch.profiler.profile(activities=activities) as seen:
        for _ in range(STEPS):
            step.gradients(samples)
            step.update(1.0)
        if on_gpu:
            torch.cuda.synchronize()
    order = "self_device_time_total" if on_gpu else "self_cpu_time_total"
    return seen.key_averages().table(sort_by=order, row_limit=KERNELS, max_name_column_width=60)
