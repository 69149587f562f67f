"""What the paper's model computes on a GPU is something that every GPU can: Apple's have no float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dante_w.field.cpu import step as cpu_step
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.inference import psnr
from dante_w.field.optimise import Problem, Schedule, fit
from dante_w.field.resolution import limit_resolution
from dante_w.field.scale_ambiguity import albedo_gain, start_exposures
from dante_w.field.terms import LossTerms
from dante_w.rays.ray_cache import RayCache, Surface
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

SPEC = FieldSpec(GridSpec(2, 3, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 4, 10), hidden=8, embedding=2)


class OnGpu(TorchDispatchMode):
    """Notes what float64 tensors of more than a number are made of tensors. Those of one number are brought to the CPU."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        out = func(*args, **(kwargs or {}))
        made = [value for value in tree_leaves(out) if isinstance(value, torch.Tensor)]
        if any(value.dtype == torch.float64 and value.numel() > 1 for value in made):
            self.found.append(str(func))
        return out


def some_cache() -> RayCache:
    uvs = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    positions = torch.cat([uvs, torch.zeros(1, 3, 1)], dim=2)
    random, count = np.random.default_rng(0), 600
    return RayCache(
        Surface(uvs, positions),
        np.array([0, 200, 400, 600]),
        np.zeros(count, np.int32),
        random.integers(0, 1 << 15, (count, 2)).astype(np.uint16),
        random.random((count, 3)).astype(np.float16),
        random.random((count, 4)).astype(np.float16),
        np.full(count, 0.01, np.float16),
        np.full((256, 256), 0.01, np.float32),
    )


def fitted(cache: RayCache) -> None:
    torch.manual_seed(0)
    model, ranges = (
        FieldModel(limit_resolution(SPEC, 64, cache), 3),
        np.array([[0, 200], [200, 400], [400, 600]]),
    )
    start_exposures(model, cache)
    problem = Problem(model, cache, ranges, LossTerms(True, 1.0, 0.1, 0.1))
    fit(problem, Schedule(2, 64), 0, lambda *_: None)
    psnr(model, cache, np.arange(600))
    albedo_gain(model, cache, ranges, 0)


@pytest.fixture
def by_torch(monkeypatch):
    monkeypatch.setattr(cpu_step, "supports", lambda *_: False)


def test_nothing_needs_float64(by_torch):
    with OnGpu() as seen:
        fitted(some_cache())
    assert seen.found == []


def test_float64_would_be_seen(by_torch, monkeypatch):
    whole = FieldModel.light
    monkeypatch.setattr(FieldModel, "light", lambda *arguments: whole(*arguments).double().float())
    with OnGpu() as seen:
        fitted(some_cache())
    assert seen.found
