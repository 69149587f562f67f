"""Models made as large as a scene needs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from dante_w.field.resolution import RESOLUTION, limit_resolution, with_equal_bands
from dante_w.field.settings import DRAFT, HIGH, PAPER, STANDARD
from dante_w.rays.ray_cache import RayCache, Surface

SPECS = {"draft": DRAFT.model, "standard": STANDARD.model, "high": HIGH.model, "paper": PAPER.model}


def seen_at(*texels: float, of: int = 2048) -> RayCache:
    """A cache of samples whose pixels cover so many texels of a texture of that side."""
    count = len(texels)
    surface = Surface(torch.zeros(1, 3, 2), torch.zeros(1, 3, 3))
    face, pairs, colours = (np.zeros((count, *shape), np.float16) for shape in ((), (2,), (3,)))
    footprint = np.array(texels, np.float16) / np.float16(of)
    return RayCache(surface, np.array([0, count]), face, pairs, colours, None, footprint)


@pytest.mark.parametrize(
    ("texels", "finest"), [(0.5, 2048), (1.0, 2048), (4.0, 512), (2.0, 1024), (500.0, 64)]
)
def test_albedo_is_as_fine_as_the_photos_pixels(texels, finest):
    found = limit_resolution(STANDARD.model, 4096, seen_at(*[texels] * 50)).albedo
    assert found.finest == finest
    assert found.resolutions[-1] == finest


def test_few_sharp_pixels_do_not_make_a_fine_model():
    assert limit_resolution(STANDARD.model, 4096, seen_at(*[1.0] * 20, *[8.0] * 80)).albedo.finest == 256
    assert limit_resolution(STANDARD.model, 4096, seen_at(*[1.0] * 30, *[8.0] * 70)).albedo.finest == 2048


def test_albedo_is_no_finer_than_the_texture():
    assert limit_resolution(STANDARD.model, 300, seen_at(0.1)).albedo.finest == 300
    unknown = dataclasses.replace(seen_at(9.0), footprint=None)
    assert limit_resolution(STANDARD.model, 1024, unknown).albedo.finest == 1024
    assert limit_resolution(STANDARD.model, 2048, unknown) == STANDARD.model


@pytest.mark.parametrize("model", SPECS.values(), ids=SPECS)
@pytest.mark.parametrize("texels", [0.2, 3.0, 70.0])
def test_growth_and_gap_stay(model, texels):
    small = limit_resolution(model, 8192, seen_at(texels))
    wanted = math.log(model.albedo.finest / model.albedo.coarsest) / (model.albedo.levels - 1)
    got = math.log(small.albedo.finest / small.albedo.coarsest) / (small.albedo.levels - 1)
    assert got == pytest.approx(wanted, rel=0.2)
    assert small.albedo.finest >= min(RESOLUTION.least_gap * small.irradiance.finest, model.albedo.finest)
    assert dataclasses.replace(small, albedo=model.albedo) == model


@pytest.mark.parametrize("model", SPECS.values(), ids=SPECS)
def test_equal_bands_closes_the_frequency_gap(model):
    assert model.irradiance.finest * 4 <= model.albedo.finest
    assert with_equal_bands(model).irradiance.finest == model.albedo.finest
