import numpy as np
import torch
from dante_w.core.color import (
    linear_from_srgb,
    linear_from_srgb_array,
    srgb_from_linear,
    srgb_from_linear_array,
)
from hypothesis import given
from hypothesis import strategies as st


def test_values_of_the_standard():
    linear = torch.tensor([0.0, 0.0031308, 0.18, 0.5, 1.0], dtype=torch.float64)
    expected = torch.tensor([0.0, 0.04044994, 0.46135613, 0.73535698, 1.0], dtype=torch.float64)
    torch.testing.assert_close(srgb_from_linear(linear), expected, atol=4e-8, rtol=0.0)


def test_every_8_bit_value_survives():
    srgb = torch.arange(256, dtype=torch.float32) / 255.0
    back = srgb_from_linear(linear_from_srgb(srgb))
    assert torch.equal((back * 255.0).round(), torch.arange(256, dtype=torch.float32))


@given(st.floats(-100.0, 100.0))
def test_inverse_beyond_the_unit_interval(value):
    linear = torch.tensor([value], dtype=torch.float64)
    torch.testing.assert_close(linear_from_srgb(srgb_from_linear(linear)), linear, atol=1e-7, rtol=1e-7)


@given(st.floats(-50.0, 50.0), st.floats(1e-6, 10.0))
def test_both_curves_rise(value, step):
    pair = torch.tensor([value, value + step], dtype=torch.float64)
    for curve in (srgb_from_linear, linear_from_srgb):
        low, high = curve(pair)
        assert low < high


def test_gradients_are_finite_and_right():
    values = torch.tensor([-1.0, -1e-6, 0.0, 1e-3, 0.2, 1.0, 50.0], dtype=torch.float64, requires_grad=True)
    for curve in (srgb_from_linear, linear_from_srgb):
        (gradient,) = torch.autograd.grad(curve(values).sum(), values)
        assert torch.isfinite(gradient).all() and (gradient > 0.0).all()
        assert torch.autograd.gradcheck(curve, (values,), eps=1e-8, atol=1e-5)


def test_arrays_follow_tensors_and_keep_their_type():
    values = np.linspace(-0.5, 4.0, 20, dtype=np.float32).reshape(4, 5)[:, ::2]  # not contiguous
    encoded = srgb_from_linear_array(values)
    assert encoded.dtype == np.float32 and encoded.shape == values.shape
    np.testing.assert_array_equal(encoded, srgb_from_linear(torch.tensor(values.copy())).numpy())
    np.testing.assert_allclose(linear_from_srgb_array(encoded), values, atol=1e-6)
