"""Linear colours in the numbers of a texture."""

from __future__ import annotations

import numpy as np
import pytest
from dante_w.core.color import srgb_from_linear_array
from dante_w.texture.encoding import decode_rows, encode_rows


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integers_are_srgb_rounded_to_nearest(dtype: type) -> None:
    rng = np.random.default_rng(0)
    top = np.iinfo(dtype).max
    linear = np.concatenate(
        [rng.random(99999), 10 ** rng.uniform(-9, 0.5, 99999), [0, -0.0, 1, -1, 7, np.inf]]
    )
    linear = linear.astype(np.float32).reshape(-1, 3, 4)
    expected = np.rint(srgb_from_linear_array(linear.astype(np.float64)).clip(0, 1) * top)
    codes = encode_rows(linear, np.dtype(dtype))
    assert codes.dtype == dtype and np.array_equal(codes, expected)
    assert encode_rows(np.float32([np.nan, -np.inf]), np.dtype(dtype)).tolist() == [0, 0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_code_comes_back(dtype: type) -> None:
    codes = np.arange(np.iinfo(dtype).max + 1).astype(dtype)
    assert np.array_equal(encode_rows(decode_rows(codes), np.dtype(dtype)), codes)


def test_floats_stay_linear() -> None:
    linear = np.float32([[-0.5, 0.25, 3.0, 1e30]])
    assert encode_rows(linear, np.dtype(np.float16)).tolist() == [[-0.5, 0.25, 3.0, 65504.0]]
    assert np.array_equal(encode_rows(linear, np.dtype(np.float32)), linear)
    assert np.array_equal(decode_rows(linear[:, :3].astype(np.float16)), linear[:, :3])
    with pytest.raises(ValueError, match="texture"):
        encode_rows(linear, np.dtype(np.int32))
