import dataclasses
from itertools import pairwise

import numpy as np
import pytest
import torch
from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field.batches import DRAWING, DrawingSettings, batches, blocks
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec
from dante_w.field.held_out import halves
from dante_w.field.loss import model_loss
from dante_w.field.optimise import Problem, Schedule, fit
from dante_w.field.terms import LossTerms
from dante_w.rays.finest_footprint import no_footprints, note_finest
from dante_w.rays.ray_cache import RayCache, Samples, Surface
from dante_w.scene.held_out import choose_held_out
from hypothesis import given, settings
from hypothesis import strategies as st

SPEC = FieldSpec(GridSpec(2, 4, 2, 4, 32, 10), GridSpec(3, 2, 2, 2, 8, 10), hidden=16, embedding=3)


def some_samples(prior: bool, count: int = 64) -> Samples:
    random = torch.Generator().manual_seed(1)

    def uniform(width: int) -> torch.Tensor:
        return torch.rand(count, width, generator=random)

    photo = torch.randint(0, 3, (count,), generator=random)
    return Samples(photo, uniform(2), uniform(3), uniform(3), uniform(4) if prior else None)


def test_the_loss_is_equations_6_and_7():
    torch.manual_seed(0)
    model, samples = FieldModel(SPEC, 3), some_samples(prior=True)
    albedo = model.albedo(samples.uv)
    colour = model.expose(albedo * model.light(samples.position, samples.photo), samples.photo)
    photometric = (srgb_from_linear(colour) - samples.colour).abs().mean()
    colour, confidence = samples.prior.split([3, 1], dim=1)
    prior = (confidence * (albedo - linear_from_srgb(colour)).abs()).mean()
    torch.testing.assert_close(model_loss(model, samples, LossTerms(True, 0.3)), photometric + 0.3 * prior)
    torch.testing.assert_close(model_loss(model, samples, LossTerms(False, 1.0)), prior)
    torch.testing.assert_close(model_loss(model, samples, LossTerms(True, 0.0)), photometric)


def test_tinted_light_and_offsets_cost_what_the_terms_say():
    torch.manual_seed(0)
    model, samples = FieldModel(SPEC, 3), some_samples(prior=False)
    torch.nn.init.normal_(model.offset)
    plain = model_loss(model, samples, LossTerms())
    offset = model_loss(model, samples, LossTerms(small_offset=0.5)) - plain
    torch.testing.assert_close(offset, 0.5 * model.offset[samples.photo].abs().mean())
    last = model.irradiance.decoder[-1]
    torch.nn.init.zeros_(last.weight)
    with torch.no_grad():
        last.bias[:] = 2.0  # grey light costs nothing
        grey = model_loss(model, samples, LossTerms(white_light=1.0)) - model_loss(
            model, samples, LossTerms()
        )
        last.bias[:] = torch.log(torch.expm1(torch.tensor([4.0, 2.0, 1.0])))  # softplus gives 4, 2, 1
        tinted = model_loss(model, samples, LossTerms(white_light=1.0)) - model_loss(
            model, samples, LossTerms()
        )
    assert abs(float(grey)) < 1e-6
    assert float(tinted) == pytest.approx(2.0 / 3.0 * np.log(2.0) ** 2, rel=1e-2)


def test_photos_without_a_prior_add_nothing_to_the_prior_term():
    model, samples = FieldModel(SPEC, 3), some_samples(prior=True)
    samples.prior[samples.photo == 1] = torch.nan
    loss = model_loss(model, samples, LossTerms())
    gradients = torch.autograd.grad(loss, list(model.parameters()))
    assert torch.isfinite(loss) and all(torch.isfinite(g).all() for g in gradients)
    kept = samples.photo != 1
    albedo = model.albedo(samples.uv[kept])
    colour, confidence = samples.prior[kept].split([3, 1], dim=1)
    expected = (confidence * (albedo - linear_from_srgb(colour)).abs()).sum() / (3 * len(samples.prior))
    torch.testing.assert_close(model_loss(model, samples, LossTerms(photometric=False)), expected)


def test_the_loss_agrees_with_float64():
    torch.manual_seed(0)
    model, samples = FieldModel(SPEC, 3), some_samples(prior=True)
    single = model_loss(model, samples, LossTerms())
    gradients = torch.autograd.grad(single, list(model.parameters()))
    double_samples = Samples(
        samples.photo, *(getattr(samples, n).double() for n in ("uv", "position", "colour", "prior"))
    )
    model.double()
    double = model_loss(model, double_samples, LossTerms())
    references = torch.autograd.grad(double, list(model.parameters()))
    torch.testing.assert_close(single.double(), double, rtol=1e-5, atol=1e-7)
    for gradient, reference in zip(gradients, references, strict=True):
        assert (gradient.double() - reference).norm() <= 1e-3 * reference.norm() + 1e-9


def test_without_the_photometric_term_light_is_left_alone():
    model = FieldModel(SPEC, 3)
    loss = model_loss(model, some_samples(prior=True), LossTerms(photometric=False))
    gradients = torch.autograd.grad(loss, list(model.irradiance.parameters()), allow_unused=True)
    assert all(gradient is None for gradient in gradients)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 300), min_size=1, max_size=6), st.integers(0, 5))
def test_batches_draw_the_samples_of_the_ranges_equally_and_no_other(lengths, seed):
    starts = np.cumsum([7, *(length + 3 for length in lengths[:-1])])
    ranges = np.stack([starts, starts + lengths], axis=1)
    allowed = np.concatenate([np.arange(a, b) for a, b in ranges])
    draws = batches(ranges, 4096 * DRAWING.run, seed)
    drawn = np.concatenate([next(draws) for _ in range(30)])
    assert np.isin(drawn, allowed).all()
    counts = np.bincount(drawn, minlength=ranges.max())[allowed]
    # a run counts up to its length at once, so the spread is that of so many times fewer draws
    mean = len(drawn) / len(allowed)
    assert abs(counts - mean).max() < 6 * np.sqrt(DRAWING.run * mean) + DRAWING.run


def test_of_more_samples_than_the_pool_blocks_take_turns():
    block = DRAWING.block
    ranges = np.array([[5, 5 + 10 * block + 7], [20 * block, 26 * block]])
    count = (ranges[:, 1] - ranges[:, 0]).sum()
    cut = blocks(ranges, block)
    pieces = np.concatenate([np.arange(a, b) for a, b in cut])
    np.testing.assert_array_equal(pieces, np.concatenate([np.arange(a, b) for a, b in ranges]))
    assert (cut[:, 1] - cut[:, 0]).max() == block and len(cut) == 17

    small = DrawingSettings(pool=4 * block)
    draws = batches(ranges, block, 0, settings=small)
    parts = [np.unique(np.searchsorted(cut[:, 1], next(draws), side="right")) for _ in range(340)]
    assert max(map(len, parts)) == 4  # few blocks at a time ...
    kept = np.mean([len(np.intersect1d(*pair)) for pair in pairwise(parts)])
    assert 1.7 < kept < 2.2  # ... of which two give way to others
    counts = np.delete(
        np.bincount(np.concatenate(parts), minlength=17), 10
    )  # the short one is seldom drawn from
    mean = len(parts) * 4 / 17
    assert 0.9 * mean < counts.min() and counts.max() < 1.1 * mean

    large = DrawingSettings(pool=int(count))
    whole = batches(ranges, 4096 * DRAWING.run, 0, settings=large)
    drawn = np.concatenate([next(whole) for _ in range(3)])
    assert len(np.unique(drawn)) > 0.9 * count
    for drawing in (small, large):
        later = batches(ranges, 512, 3, skipped=2, settings=drawing)
        first = batches(ranges, 512, 3, settings=drawing)
        next(first), next(first)
        np.testing.assert_array_equal(next(later), next(first))


def test_the_learning_rate_falls_along_a_cosine():
    schedule = Schedule(100, 1, final_rate=0.1)
    assert schedule.rate(0) == 1.0
    assert schedule.rate(50) == pytest.approx(0.55)
    assert schedule.rate(100) == pytest.approx(0.1)


@given(st.integers(1, 3000))
def test_one_photo_in_eight_is_held_out(photos):
    chosen = choose_held_out(photos)
    assert len(chosen) == (0 if photos < 5 else max(photos // 8, 1))
    assert len(np.unique(chosen)) == len(chosen)
    assert len(chosen) == 0 or (chosen.min() >= 0 and chosen.max() < photos)


@given(st.integers(1, 10_000))
def test_the_halves_of_a_held_out_photo_do_not_overlap(length):
    fitted, scored = halves(np.array([[5, 5 + length]]), 32)
    parts = [np.arange(a, b) for a, b in np.concatenate([fitted, scored])]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(5, 5 + length))


#: Texels a side of a texture whose detail is two texels wide, and the texels that a pixel from afar covers.
SIDE, FAR = 64, 8


def fine_texture() -> np.ndarray:
    texels = np.random.default_rng(0).uniform(0.1, 0.8, (SIDE, SIDE, 3))
    return sum(np.roll(texels, shift, (0, 1)) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))) / 4.0


def seen_from(texture: np.ndarray, uv: np.ndarray, texels: int) -> np.ndarray:
    """Colours (N, 3) of pixels at (N, 2) that cover a square of so many texels."""
    offsets = (np.arange(2 * texels) + 0.5) / 2 - texels / 2
    places = uv[:, None, None] * SIDE + np.stack(np.meshgrid(offsets, offsets), axis=-1)
    column, row = np.moveaxis(places.astype(int).clip(0, SIDE - 1), -1, 0)
    return texture[row, column].mean((1, 2))


def two_distances(near: int, far: int) -> tuple[RayCache, np.ndarray]:
    """A square whose left half is seen from nearby and all of it from afar, with its colours as priors; its texture."""
    random, texture = np.random.default_rng(1), fine_texture()
    uv = np.concatenate([random.random((near, 2)) * [0.5, 1.0], random.random((far, 2))])
    texels = np.repeat([1, FAR], [near, far])
    colour = np.empty((near + far, 3))
    for width in (1, FAR):
        colour[texels == width] = seen_from(texture, uv[texels == width], width)
    u, v = uv.T
    bary = np.where((v <= u)[:, None], np.stack([u - v, v], 1), np.stack([u, v - u], 1))
    footprint, finest = (texels / SIDE).astype(np.float16), no_footprints()
    note_finest(uv, footprint.astype(np.float32), finest)
    corners = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]])
    srgb = srgb_from_linear(torch.from_numpy(colour)).numpy().astype(np.float16)
    cache = RayCache(
        Surface(corners, torch.zeros(2, 3, 3)),
        np.array([0, near + far]),
        (v > u).astype(np.int32),
        np.rint(bary * 65535.0).astype(np.uint16),
        srgb,
        np.pad(srgb, [(0, 0), (0, 1)], constant_values=1.0),
        footprint,
        finest,
    )
    return cache, texture


def left_and_right_error(albedo: GridSpec, cache: RayCache, texture: np.ndarray) -> np.ndarray:
    """PSNR in dB of the albedo fitted to the priors alone, in either half of the texture."""
    torch.manual_seed(0)
    model = FieldModel(FieldSpec(albedo, GridSpec(3, 1, 2, 2, 2, 8), hidden=16, embedding=2), 1)
    everything = np.array([[0, len(cache)]])
    schedule = Schedule(200, 2048, 1e-2)
    problem = Problem(model, cache, everything, LossTerms(photometric=False))
    fit(problem, schedule, 0, lambda *_: None)
    centre = (np.arange(SIDE) + 0.5) / SIDE
    uv = torch.from_numpy(np.stack(np.meshgrid(centre, centre), axis=-1)).float().reshape(-1, 2)
    with torch.no_grad():
        error = (model.albedo(uv).numpy().reshape(SIDE, SIDE, 3) - texture) ** 2
    margin = FAR // 2
    halves = error[:, margin : SIDE // 2 - margin], error[:, SIDE // 2 + margin : -margin]
    return np.array([-10.0 * np.log10(half.mean()) for half in halves])


def test_pixels_from_afar_do_not_blur_what_closer_ones_tell():
    albedo = GridSpec(2, 5, 2, 8, SIDE, 14)
    alone, texture = two_distances(40_000, 0)
    mixed, _ = two_distances(40_000, 200_000)
    unweighted = dataclasses.replace(mixed, footprint=None)
    near, weighted, plain = (
        left_and_right_error(albedo, cache, texture) for cache in (alone, mixed, unweighted)
    )
    assert plain[0] < near[0] - 5.0  # what the weights are for
    assert weighted[0] > plain[0] + 0.65 * (near[0] - plain[0])
    assert weighted[1] > plain[1] - 0.3  # where no closer pixel looks, those from afar count in full
