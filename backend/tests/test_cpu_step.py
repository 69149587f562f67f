"""The CPU's step of the fit against plain torch in float64: values, gradients, Adam; the same bytes every time."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.core.jit import njit_fast
from dante_w.field.cpu import step as cpu_step
from dante_w.field.cpu.kernels import functions
from dante_w.field.cpu.step import CpuStep
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.inference import albedo_at, light_at
from dante_w.field.optimise import step_for
from dante_w.field.step import TorchStep
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import Samples

PHOTOS = 5
LIGHT = GridSpec(3, 3, 2, 2, 12, 10)
SPECS = {
    "hash": FieldSpec(GridSpec(2, 5, 2, 4, 90, 10), LIGHT, hidden=16, embedding=3),
    "wide": FieldSpec(GridSpec(2, 3, 3, 4, 32, 12), GridSpec(3, 2, 1, 2, 8, 10), hidden=33, embedding=8),
    "dense": FieldSpec(GridSpec(2, 2, 2, 4, 32, 12), LIGHT, hidden=16, embedding=3),
}
TERMS = {
    "priors": LossTerms(True, 0.7),
    "no priors": LossTerms(True, 1.0, white_light=0.1, small_offset=0.3),
    "priors alone": LossTerms(False, 1.0),
}


def some_model(spec: FieldSpec) -> FieldModel:
    torch.manual_seed(0)
    model = FieldModel(spec, PHOTOS)
    for grid in (model.albedo.grid, model.irradiance.grid):
        torch.nn.init.normal_(grid.tables, std=0.5)
    for parameter in (model.log_exposure, model.offset):
        torch.nn.init.normal_(parameter, std=0.2)
    return model


def some_samples(count: int, prior: bool) -> Samples:
    random = torch.Generator().manual_seed(1)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=random)

    photo = torch.randint(0, PHOTOS, (count,), generator=random)
    known = uniform(count, 4) if prior else None
    if known is not None:
        known[photo == 1] = torch.nan
    return Samples(photo, uniform(count, 2), uniform(count, 3), uniform(count, 3), known, uniform(count))


def in_float64(model: FieldModel, samples: Samples) -> tuple[FieldModel, Samples]:
    exact = FieldModel(model.spec, PHOTOS).double()
    exact.load_state_dict(model.state_dict())
    values = {f.name: getattr(samples, f.name) for f in dataclasses.fields(samples)}
    floats = {name: v.double() for name, v in values.items() if name != "photo" and v is not None}
    return exact, dataclasses.replace(samples, **floats)


def all_of(model: FieldModel) -> list[torch.nn.Parameter]:
    return list(model.parameters())


@pytest.mark.parametrize("count", [1, 77, 4000])
@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS.keys())
@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS.keys())
def test_loss_and_gradients_are_those_of_the_reference(spec, terms, count):
    model, samples = some_model(spec), some_samples(count, prior=terms.small_offset == 0.0)
    exact_model, exact_samples = in_float64(model, samples)
    loss, ours = CpuStep(model, terms, all_of(model), 1e-2).gradients(samples)
    exact_loss, exact = TorchStep(exact_model, terms, all_of(exact_model), 1e-2).gradients(exact_samples)
    assert loss == pytest.approx(float(exact_loss), rel=1e-5)
    assert ours.keys() == dict(model.named_parameters()).keys()
    for name, gradient in ours.items():
        reference = exact[name].numpy() if name in exact else np.zeros(gradient.shape)
        assert np.linalg.norm(gradient - reference) <= 1e-4 * np.linalg.norm(reference) + 1e-9, name


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS.keys())
def test_values_without_gradients_are_those_of_the_reference(spec):
    model, samples = some_model(spec), some_samples(3000, prior=False)
    exact_model, exact_samples = in_float64(model, samples)
    albedo, light = albedo_at(model, samples.uv), light_at(model, samples.position, samples.photo)
    with torch.no_grad():
        exact = exact_model.albedo(exact_samples.uv), exact_model.light(exact_samples.position, samples.photo)
    torch.testing.assert_close(albedo.double(), exact[0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(light.double(), exact[1], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS.keys())
def test_steps_follow_torch_where_every_entry_is_touched(spec):
    """Entries that no sample touches stay, unlike in torch's Adam: so they are compared where all are."""
    small = {"albedo": GridSpec(2, 2, 2, 4, 8, 8), "irradiance": GridSpec(3, 2, 2, 2, 4, 8)}
    model = some_model(dataclasses.replace(spec, **small))
    exact_model, _ = in_float64(model, some_samples(1, prior=False))
    ours, exact = (
        kind(m, TERMS["no priors"], all_of(m), 1e-3)
        for kind, m in ((CpuStep, model), (TorchStep, exact_model))
    )
    for step in range(5):
        samples = some_samples(4096, prior=False)
        ours.gradients(samples)
        exact.gradients(in_float64(model, samples)[1])
        ours.update(1.0 - 0.1 * step)
        exact.update(1.0 - 0.1 * step)
    for mine, reference in zip(model.parameters(), exact_model.parameters(), strict=True):
        torch.testing.assert_close(mine.double(), reference, rtol=1e-3, atol=1e-4)


def test_an_entry_that_no_sample_touches_stays_with_its_moments():
    model = some_model(SPECS["dense"])
    before = model.albedo.grid.tables.detach().clone()
    step = CpuStep(model, TERMS["no priors"], all_of(model), 1e-2)
    samples = some_samples(64, prior=False)
    left = dataclasses.replace(samples, uv=samples.uv * 0.4)
    step.gradients(left)
    step.update(1.0)
    once = model.albedo.grid.tables.detach().clone()
    moved = (once != before).any(1)
    step.gradients(dataclasses.replace(samples, uv=1.0 - samples.uv * 0.4))
    step.update(1.0)
    twice = model.albedo.grid.tables.detach()
    finest = slice(-33 * 33, None)
    assert moved[finest].any()
    assert torch.equal(twice[finest][moved[finest]], once[finest][moved[finest]])


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS.keys())
def test_any_number_of_threads_gives_the_same_bytes(spec, monkeypatch):
    results = []
    for threads in (1, 2, 2, 5):
        with ThreadPoolExecutor(threads) as pool:
            monkeypatch.setattr(cpu_step, "_threads", lambda pool=pool: pool)
            model = some_model(spec)
            step = CpuStep(model, TERMS["priors"], all_of(model), 1e-2)
            losses = []
            for _ in range(3):
                losses.append(step.gradients(some_samples(5000, prior=True))[0])
                step.update(1.0)
        results.append((losses, [parameter.detach().numpy().tobytes() for parameter in model.parameters()]))
    assert all(result == results[0] for result in results)


#: Prints a hash of loss and gradients.
ONE_STEP = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
from test_cpu_step import SPECS, TERMS, CpuStep, all_of, some_model, some_samples

model = some_model(SPECS["hash"])
step = CpuStep(model, TERMS["no priors"], all_of(model), 1e-2)
loss, gradients = step.gradients(some_samples(5000, prior=False))
print(hashlib.sha256(b"".join([repr(loss).encode(), *(g.tobytes() for g in gradients.values())])).hexdigest())
"""


@pytest.mark.slow
def test_kernels_just_compiled_and_kept_ones_give_the_same_bytes(tmp_path):
    """They did not while kernels called their helpers: the cached code of a kernel has a body of its own of each helper."""
    command = [sys.executable, "-c", ONE_STEP, str(Path(__file__).parent)]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run(command, env=environment, capture_output=True, check=True, text=True).stdout
        for _ in range(2)
    )
    assert any(tmp_path.rglob("*.nbc"))
    assert first == second


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS.keys())
def test_odd_samples_leave_everything_finite(spec):
    model = some_model(spec)
    with torch.no_grad():
        model.log_exposure[0], model.log_exposure[1] = 500.0, -500.0
        model.offset[2] = -1e4
        model.albedo.grid.tables *= 100.0
        model.irradiance.grid.tables *= 100.0
    odd = torch.tensor([torch.nan, torch.inf, -torch.inf, -7.0, 65504.0, 0.0])
    samples = some_samples(6**2, prior=True)
    samples.uv[:, 0], samples.uv[:, 1] = odd.repeat(6), odd.repeat_interleave(6)
    samples.position[:, 0] = odd.repeat(6)
    samples.colour[:, 0] = odd[3:].repeat(12)
    samples.prior[:, 0] = odd.repeat(6)
    step = CpuStep(model, LossTerms(True, 1.0, 0.1, 0.1), all_of(model), 1e-2)
    for _ in range(3):
        loss, gradients = step.gradients(samples)
        assert np.isfinite(loss)
        assert all(np.isfinite(gradient).all() for gradient in gradients.values())
        step.update(1.0)
    assert all(torch.isfinite(parameter).all() for parameter in model.parameters())


def test_only_the_chosen_parameters_change():
    model, samples = some_model(SPECS["hash"]), some_samples(500, prior=False)
    before = {name: p.detach().clone() for name, p in model.named_parameters()}
    step = CpuStep(model, LossTerms(), model.photo_parameters(), 1e-2)
    step.gradients(samples)
    step.update(1.0)
    changed = {name for name, p in model.named_parameters() if not torch.equal(p, before[name])}
    assert changed == {"embedding", "log_exposure", "offset"}


def test_the_kernels_serve_the_models_they_know():
    model = some_model(SPECS["hash"])
    assert isinstance(step_for(model, LossTerms(), all_of(model), 1e-2), CpuStep)
    assert isinstance(step_for(model.double(), LossTerms(), all_of(model), 1e-2), TorchStep)


def test_functions_agree_with_torch():
    x = np.concatenate([np.linspace(-40, 40, 3001), [-0.0, 0.0, 0.0031, 0.0404]]).astype(np.float32)
    exact = torch.from_numpy(x.astype(np.float64)).requires_grad_()
    ours = np.empty((5, len(x)), np.float32)
    _all_functions(x, ours)
    encoded = srgb_from_linear(exact)
    (slope,) = torch.autograd.grad(encoded.sum(), exact)
    wanted = [
        torch.nn.functional.softplus(exact),
        torch.sigmoid(exact),
        encoded,
        slope,
        linear_from_srgb(exact),
    ]
    for mine, reference in zip(ours, wanted, strict=True):
        np.testing.assert_allclose(mine, reference.detach().numpy(), rtol=1e-5, atol=1e-6)


@njit_fast
def _all_functions(x, out):
    for i in range(len(x)):
        out[0, i], out[1, i] = functions.softplus(x[i]), functions.sigmoid(x[i])
        out[2, i], out[3, i] = functions.srgb_from_linear(x[i])
        out[4, i] = functions.linear_from_srgb(x[i])
