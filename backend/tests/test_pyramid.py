"""Pyramids: levels, values at texel centres, and the sum."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dante_w.field.fields import AlbedoField
from dante_w.field.pyramid import PyramidSpec


@pytest.mark.parametrize(
    ("spec", "sides"),
    [
        (PyramidSpec(16, 128), [16, 32, 64, 128]),
        (PyramidSpec(4, 4), [4]),
        (PyramidSpec(16, 3000), [16, 30, 59, 113, 219, 421, 810, 1559, 3000]),
    ],
)
def test_every_level_is_a_whole_texture_about_twice_as_fine(spec, sides):
    assert spec.grid.sides == sides
    assert spec.grid.entries == [side**2 for side in sides]


def test_albedo_at_a_texel_centre_is_that_texel():
    field = AlbedoField(PyramidSpec(8, 8), hidden=0)
    torch.nn.init.normal_(field.grid.tables)
    centre = (torch.arange(8) + 0.5) / 8
    uv = torch.cartesian_prod(centre, centre).flip(1)  # rows of texels
    with torch.no_grad():
        torch.testing.assert_close(field(uv), torch.sigmoid(field.grid.tables))


def test_levels_add_up():
    field = AlbedoField(PyramidSpec(2, 8), hidden=0)
    with torch.no_grad():
        for value, (first, end) in zip((0.5, -2.0, 1.0), ((0, 4), (4, 20), (20, 84)), strict=True):
            field.grid.tables[first:end] = value
        np.testing.assert_allclose(field(torch.rand(9, 2)).numpy(), 1.0 / (1.0 + np.exp(0.5)), rtol=1e-6)
