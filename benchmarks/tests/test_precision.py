"""The precision benchmark measures what it says: each way in its own type, failures as words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import precision
import pytest
import torch
from dante_w.field.cpu import step as fused
from dante_w.field.fields import Model
from precision import EXACT, Row, Way, measure, one_step, texture

FLOAT32 = Way("float32", torch.float32)


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(precision, "BATCH", 256)
        patch.setattr(precision, "TEXTURE", 32)
        yield


@pytest.fixture(scope="module")
def rows() -> dict[str, Row]:
    ways = [
        replace(EXACT, name="moved", moved=1e-12),
        FLOAT32,
        replace(FLOAT32, name="numba", reference=False),
        replace(FLOAT32, name="autocast", autocast=torch.bfloat16),
        Way("bfloat16", torch.bfloat16),
        Way("8 bits", torch.float8_e4m3fn),
    ]
    return {row.name: row for row in measure(12, ways)}


def test_errors_follow_the_number_of_bits(rows: dict[str, Row]) -> None:
    for name in ("float32", "numba"):
        assert 0.0 < rows[name].fields < 1e-4
        assert all(0.0 < l2 < 1e-3 for l2, _ in rows[name].gradients.values())
    assert rows["autocast"].fields == rows["float32"].fields  # the tables stay float32
    assert rows["autocast"].gradients["decoders"][0] > 100 * rows["float32"].gradients["decoders"][0]
    assert rows["bfloat16"].fields > 100 * rows["float32"].fields


def test_fits_drift_from_float64_with_their_errors(rows: dict[str, Row]) -> None:
    # 59 dB where autocast keeps the weights of the first step
    assert rows["moved"].from_float64 > rows["float32"].from_float64 > rows["autocast"].from_float64 > 70.0


def test_what_cannot_run_says_why(rows: dict[str, Row]) -> None:
    row = rows["8 bits"]
    assert row.failed
    assert row.from_truth is None
    assert f"| 8 bits |  | {row.failed} |" in precision.fit_table([row])


def test_a_loss_scale_leaves_loss_and_gradients_as_they_are() -> None:
    torch.manual_seed(0)
    model = Model(precision.SPEC, precision.PHOTOS).double()
    plain, scaled = one_step(model, EXACT), one_step(model, replace(EXACT, loss_scale=1024.0))
    assert scaled.loss == pytest.approx(plain.loss, rel=1e-14)
    for name in precision.GROUPS:
        torch.testing.assert_close(scaled.gradients[name], plain.gradients[name], rtol=1e-9, atol=0.0)


def test_the_torch_path_is_taken_and_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    kernels = fused.decoded
    monkeypatch.setattr(fused, "decoded", lambda *a: calls.append(1) or kernels(*a))
    model = Model(precision.SPEC, precision.PHOTOS)
    by_torch = texture(model, FLOAT32)
    assert len(calls) == 0
    by_numba = texture(model, replace(FLOAT32, reference=False))
    assert len(calls) == 1
    np.testing.assert_allclose(by_torch, by_numba, atol=1e-5)
