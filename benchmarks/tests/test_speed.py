"""The speed benchmark times what it says, on equal terms, and says so in one JSON object."""

from __future__ import annotations

import json
import time
from functools import partial

import numpy as np
import pytest
import speed
import torch
from dante_w.field.cpu.step import CpuStep
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.optimise import Schedule
from dante_w.field.settings import FieldSettings
from dante_w.field.step import TorchStep
from dante_w.presets import Preset
from measure.turns import median_seconds

SPEC = FieldSpec(GridSpec(2, 3, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 4, 10), hidden=8, embedding=2)
FIELD = FieldSettings(SPEC, Schedule(10, 300), Schedule(2, 300))
SMALL = {"standard": Preset("standard", 64, None, FIELD)}


def test_the_last_line_has_every_figure(capsys: pytest.CaptureFixture) -> None:
    speed.main(["--rounds", "2", "--json"], SMALL)
    out = capsys.readouterr().out
    found = json.loads(out.splitlines()[-1])
    rates = found["samples_per_second"]
    assert found["full_step_ratio"] == pytest.approx(rates[speed.NUMBA] / rates[speed.TORCH])
    assert found["batch"] == 300
    assert all(rates[name] == pytest.approx(300 / found["step_seconds"][name]) for name in rates)
    assert "| whole step |" in out


def test_both_paths_compute_the_same_step() -> None:
    torch.manual_seed(0)
    model, samples = FieldModel(SPEC, speed.PHOTOS), speed.batch_of(300)
    parameters = list(model.parameters())
    ways = (way(model, speed.TERMS, parameters, 1e-3) for way in (TorchStep, CpuStep))
    (slow_loss, slow), (fast_loss, fast) = (way.gradients(samples) for way in ways)
    assert float(slow_loss) == pytest.approx(fast_loss, rel=1e-5)
    assert slow.keys() == fast.keys()
    for name, gradient in slow.items():
        np.testing.assert_allclose(fast[name], gradient.numpy(), atol=1e-3 * float(gradient.abs().max()))


def test_works_take_turns_and_the_median_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, now = [], [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    lengths = {"a": iter([99.0, 1.0, 5.0, 2.0]), "b": iter([99.0, 7.0, 7.0, 8.0])}

    def work(name: str) -> None:
        calls.append(name)
        now[0] += next(lengths[name])

    works = {name: partial(work, name) for name in "ab"}
    assert median_seconds(works, 3) == {"a": 2.0, "b": 7.0}
    assert calls == ["a", "b"] * 4


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_cuda_is_said_not_to_run(capsys: pytest.CaptureFixture) -> None:
    speed.main(["--device", "cuda", "--json"])
    out = capsys.readouterr().out
    found = json.loads(out.splitlines()[-1])
    assert "could not be run here" in out
    assert found["could_not_be_run"] == "this torch finds no CUDA GPU"
    assert "full_step_ratio" not in found
