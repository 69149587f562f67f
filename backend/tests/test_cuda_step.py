"""The CUDA step of the fit against plain torch in float64: values, gradients, Adam. On a machine without a CUDA GPU the same
kernels run in Triton's interpreter."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from dante_w.field.cuda import grid as cuda_grid
from dante_w.field.cuda.step import CudaStep
from dante_w.field.hash_encoding import GridSpec, encode_reference
from dante_w.field.inference import albedo_at
from dante_w.field.optimise import step_for
from dante_w.field.step import TorchStep
from dante_w.field.terms import LossTerms
from test_cpu_step import SPECS, TERMS, all_of, in_float64, some_model, some_samples

pytest.importorskip("triton", reason="the CUDA kernels are written in it; there are wheels for Linux alone")
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"

GRIDS = {
    "dense and hashed 2D": GridSpec(2, 5, 2, 4, 90, 10),
    "3D": GridSpec(3, 4, 2, 2, 24, 10),
    "three features": GridSpec(2, 3, 3, 4, 32, 12),
    "one feature": GridSpec(3, 2, 1, 2, 8, 10),
}


#: The interpreter takes its time for each program, whatever its size.
LAUNCH = cuda_grid.Launch(points=1024, numbers=1 << 14) if DEVICE == "cpu" else cuda_grid.LAUNCH


def on_device(samples):
    values = {field.name: getattr(samples, field.name) for field in dataclasses.fields(samples)}
    return dataclasses.replace(
        samples, **{name: v if v is None else v.to(DEVICE) for name, v in values.items()}
    )


def some_tables(spec: GridSpec) -> torch.Tensor:
    return torch.randn(sum(spec.entries), spec.features, generator=torch.Generator().manual_seed(0))


def some_points(count: int, dimensions: int) -> torch.Tensor:
    """With both ends of the range, points beyond it and odd ones."""
    points = torch.rand(count, dimensions, generator=torch.Generator().manual_seed(2))
    odd = torch.tensor([0.0, 1.0, -3.0, 7.0, torch.nan, torch.inf, -torch.inf, 1.0 - 2.0**-24])
    if count > len(odd):
        points[: len(odd), 0], points[: len(odd), -1] = odd, odd.flip(0)
    return points


@pytest.mark.parametrize("count", [1, 300])
@pytest.mark.parametrize("spec", GRIDS.values(), ids=GRIDS.keys())
def test_encoding_and_its_transpose_are_those_of_the_reference(spec, count):
    tables, points = some_tables(spec), some_points(count, spec.dimensions)
    exact = tables.double().requires_grad_()
    wanted = encode_reference(points.double(), exact, spec)
    encoded = cuda_grid.encode(points.to(DEVICE), tables.to(DEVICE), spec, LAUNCH)
    torch.testing.assert_close(encoded.cpu().double(), wanted, rtol=1e-4, atol=1e-4)
    upstream = torch.randn(count, spec.width, generator=torch.Generator().manual_seed(3))
    (slope,) = torch.autograd.grad(wanted, exact, upstream.double())
    found = torch.zeros(exact.numel(), device=DEVICE)
    for group in cuda_grid.level_groups(spec):
        rest = found[group.start * spec.features :]
        cuda_grid.scatter(points.to(DEVICE), upstream.to(DEVICE), spec, group, rest, LAUNCH)
    assert (found.cpu().double().view_as(slope) - slope).norm() <= 1e-4 * slope.norm()


def test_groups_are_all_levels_in_order_and_none_is_larger_than_the_largest_level():
    for spec in GRIDS.values():
        groups = cuda_grid.level_groups(spec)
        assert [level for g in groups for level in range(g.first, g.first + g.levels)] == list(
            range(spec.levels)
        )
        assert all(g.entries == sum(spec.entries[g.first : g.first + g.levels]) for g in groups)
        assert all(g.start == sum(spec.entries[: g.first]) for g in groups)
        assert max(g.entries for g in groups) == max(spec.entries)
    assert len(cuda_grid.level_groups(GRIDS["dense and hashed 2D"])) == 3


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS.keys())
@pytest.mark.parametrize("spec", ["hash", "dense"])
def test_loss_and_gradients_are_those_of_the_reference(spec, terms):
    model, samples = some_model(SPECS[spec]), some_samples(500, prior=terms.small_offset == 0.0)
    exact_model, exact_samples = in_float64(model, samples)
    model.to(DEVICE)
    loss, ours = CudaStep(model, terms, all_of(model), 1e-2, LAUNCH).gradients(on_device(samples))
    exact_loss, exact = TorchStep(exact_model, terms, all_of(exact_model), 1e-2).gradients(exact_samples)
    assert float(loss) == pytest.approx(float(exact_loss), rel=1e-5)
    assert ours.keys() == exact.keys()
    for name, gradient in ours.items():
        error = (gradient.cpu().double() - exact[name]).norm()
        assert error <= 1e-4 * exact[name].norm() + 1e-9, name


def test_steps_follow_torch_where_every_entry_is_touched():
    """Moments in bfloat16 cost this much and no more: after ten steps, 3 percent of the way that a number has gone."""
    model = some_model(
        dataclasses.replace(
            SPECS["hash"], albedo=GridSpec(2, 1, 2, 4, 4, 8), irradiance=GridSpec(3, 1, 2, 2, 2, 8)
        )
    )
    before = [parameter.detach().double() for parameter in model.parameters()]
    exact_model, _ = in_float64(model, some_samples(1, prior=False))
    model.to(DEVICE)
    ours = CudaStep(model, TERMS["no priors"], all_of(model), 1e-3, LAUNCH)
    exact = TorchStep(exact_model, TERMS["no priors"], all_of(exact_model), 1e-3)
    for step in range(10):
        samples = some_samples(1024, prior=False)
        ours.gradients(on_device(samples))
        exact.gradients(in_float64(model, samples)[1])
        ours.update(1.0 - 0.05 * step)
        exact.update(1.0 - 0.05 * step)
    for mine, reference, start in zip(model.parameters(), exact_model.parameters(), before, strict=True):
        assert (mine.cpu().double() - reference).norm() <= 0.03 * (reference - start).norm()


def test_moments_are_right_on_average():
    """A change of v by less than bfloat16 can tell is lost when rounded to the nearest, and not here."""
    count, g = 1 << 14, torch.linspace(0.5, 1.5, 1 << 14)
    value, mean, square = torch.zeros(count), torch.zeros(count), torch.ones(count)
    state = [t.to(DEVICE) for t in (value, mean.bfloat16(), square.bfloat16(), torch.empty(count))]
    for step in range(1, 51):
        state[3].copy_(g)
        cuda_grid.adam(*state, cuda_grid.AdamStep(1e-3, 1.0, step), LAUNCH)
        mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g * g
    assert not state[3].any()
    for found, exact in ((state[1], mean), (state[2], square)):
        off = found.cpu().float() / exact - 1.0
        assert off.abs().max() < 0.1
        assert abs(float(off.mean())) < 5e-4


def test_an_entry_that_no_sample_touches_stays_with_its_moments():
    model = some_model(SPECS["dense"]).to(DEVICE)
    step = CudaStep(model, TERMS["no priors"], all_of(model), 1e-2, LAUNCH)
    samples, before = some_samples(64, prior=False), model.albedo.grid.tables.detach().clone()
    finest = slice(-33 * 33, None)
    step.gradients(on_device(dataclasses.replace(samples, uv=samples.uv * 0.4)))
    step.update(1.0)
    once = model.albedo.grid.tables.detach().clone()
    moved = (once != before).any(1)[finest]
    step.gradients(on_device(dataclasses.replace(samples, uv=1.0 - samples.uv * 0.4)))
    step.update(1.0)
    assert moved.any()
    assert torch.equal(model.albedo.grid.tables.detach()[finest][moved], once[finest][moved])


def test_only_the_chosen_parameters_change():
    model = some_model(SPECS["hash"]).to(DEVICE)
    before = {name: p.detach().clone() for name, p in model.named_parameters()}
    step = CudaStep(model, LossTerms(), model.photo_parameters(), 1e-2, LAUNCH)
    step.gradients(on_device(some_samples(200, prior=False)))
    step.update(1.0)
    changed = {name for name, p in model.named_parameters() if not torch.equal(p, before[name])}
    assert changed == {"embedding", "log_exposure", "offset"}


def test_odd_samples_leave_everything_finite():
    model = some_model(SPECS["hash"])
    with torch.no_grad():
        model.log_exposure[0], model.log_exposure[1] = 500.0, -500.0
    samples = some_samples(36, prior=True)
    odd = torch.tensor([torch.nan, torch.inf, -torch.inf, -7.0, 65504.0, 0.0])
    samples.uv[:, 0], samples.position[:, 0] = odd.repeat(6), odd.repeat_interleave(6)
    model.to(DEVICE)
    step = CudaStep(model, TERMS["priors"], all_of(model), 1e-2, LAUNCH)
    for _ in range(2):
        loss, _ = step.gradients(on_device(samples))
        assert torch.isfinite(loss)
        step.update(1.0)
    assert all(torch.isfinite(parameter).all() for parameter in model.parameters())


@pytest.mark.skipif(DEVICE == "cpu", reason="chosen for CUDA alone")
def test_it_is_chosen_on_cuda():
    model = some_model(SPECS["hash"]).to(DEVICE)
    assert cuda_grid.failure() is None
    assert isinstance(step_for(model, LossTerms(), all_of(model), 1e-2), CudaStep)
    with torch.no_grad():
        samples = some_samples(1000, prior=False)
        wanted = model.cpu().double().albedo(samples.uv.double())
        found = albedo_at(model.float().to(DEVICE), samples.uv.to(DEVICE))
    torch.testing.assert_close(found.cpu().double(), wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("capability", [80, 90])
def test_the_kernels_compile_without_a_gpu(capability):
    """The interpreter passes over what the compiler does not."""
    script = Path(__file__).with_name("compile_triton.py")
    environment = {key: value for key, value in os.environ.items() if key != "TRITON_INTERPRET"}
    done = subprocess.run(
        [sys.executable, script, str(capability)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["encode_kernel", "scatter_kernel", "adam_kernel"]
