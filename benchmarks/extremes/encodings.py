"""Hash encodings of any resolution and table, and the number types of encodings, losses and gradients, against float64."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field import optimise
from dante_w.field.cpu import step as fused
from dante_w.field.cpu.kernels.functions import linear_from_srgb as kernel_linear
from dante_w.field.cpu.kernels.functions import srgb_from_linear as kernel_srgb
from dante_w.field.hash_encoding import GridSpec, HashGrid, encode_reference
from dante_w.field.optimise import model_loss
from dante_w.field.pyramid import LevelSum
from precision import (
    CLUSTERS,
    EXACT,
    PHOTOS,
    SPEC,
    TERMS,
    Way,
    compare,
    fitted_from,
    one_step,
    prepared,
    samples_for,
)
from precision import Row as Errors

from extremes.row import Row

FAMILY = "encodings and number types"
POINTS = 4096
HIGHEST = 1e15  # encoded; its linear value is near the end of float32


def rows(progress: Callable[[str], None]) -> Iterator[Row]:
    progress("grids")
    for dimensions in (2, 3):
        for finest in (16, 256, 4096, 65536):
            for log2_table in (4, 14, 19):
                yield grid_row(dimensions, finest, log2_table)
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        progress(str(dtype))
        yield type_row(dtype)
    progress("steps")
    yield from step_rows()
    progress("sRGB")
    yield from transfer_rows()
    progress("losses")
    yield loss_row()


def grid_row(dimensions: int, finest: int, log2_table: int) -> Row:
    """The product's float32 encoding on the CPU against float64, values and gradients; corners of the cube included."""
    spec = GridSpec(dimensions, 4, 3, 15, finest, log2_table)  # no powers of two: these round to nothing
    grid, points, exact = _problem(spec)
    found = fused.decoded(grid, LevelSum(), points, None).double().numpy()
    upstream = torch.linspace(-1.0, 1.0, exact.numel(), dtype=torch.float64).reshape(exact.shape)
    table = grid.tables.detach().double().requires_grad_()
    (wanted,) = torch.autograd.grad(
        encode_reference(points.double(), table, spec).unflatten(1, (-1, 3)).sum(1), table, upstream
    )
    own = grid.tables
    (gradient,) = torch.autograd.grad(
        encode_reference(points, own, spec).unflatten(1, (-1, 3)).sum(1), own, upstream.float()
    )
    error = float(np.abs(found - exact.numpy()).max()) / float(exact.abs().max())
    slope = float((gradient.double() - wanted).norm() / wanted.norm())
    # a place in the unit interval is known to 2^-24, so one in the grid to N 2^-24 cells
    bound = 0.5 * dimensions * finest * 2.0**-24 + 4e-6
    sound = bool(torch.isfinite(gradient).all()) and bool(np.isfinite(found).all())
    collisions = (finest + 1) ** dimensions / min((finest + 1) ** dimensions, 1 << log2_table)
    return Row(
        f"{dimensions}D grid up to {finest}, tables of 2^{log2_table}, float32",
        FAMILY,
        f"values {error:.1e}, gradients {slope:.1e}",
        f"both at most {bound:.1e}, finite",
        sound and error <= bound and slope <= bound,
        f"{collisions:.3g} vertices an entry on the finest level",
    )


def type_row(dtype: torch.dtype) -> Row:
    """Tables of any type: places stay in float32, so only the values round."""
    grid, points, exact = _problem(GridSpec(2, 4, 3, 16, 4096, 14))
    tables = grid.tables.detach().to(dtype)
    found = encode_reference(points, tables, grid.spec).unflatten(1, (-1, 3)).double().sum(1)
    error = float((found - exact).abs().max() / exact.abs().max())
    bound = 4.0 * torch.finfo(dtype).eps + 4096 * 2.0**-24
    name = str(dtype).removeprefix("torch.")
    return Row(
        f"grid up to 4096, tables in {name}", FAMILY, f"{error:.1e}", f"at most {bound:.1e}", error <= bound
    )


def step_rows() -> Iterator[Row]:
    """One step of the whole fit at a fitted model: losses and gradients."""
    torch.manual_seed(0)
    start = optimise.Model(SPEC, PHOTOS).double()
    fitted = fitted_from(start, EXACT, 20)
    exact = one_step(fitted, EXACT)
    ways = {
        Way("float32, torch", torch.float32): 1e-5,
        Way("float32, numba", torch.float32, reference=False): 1e-5,
        Way("bfloat16 autocast", torch.float32, torch.bfloat16): 0.1,
        Way("float16 autocast", torch.float32, torch.float16, loss_scale=1024.0): 0.05,
    }
    for way, bound in ways.items():
        errors = Errors(way.name)
        compare(errors, one_step(prepared(fitted, way), way), exact)
        assert errors.gradients is not None and errors.loss is not None
        worst = max(errors.gradients[group][0] for group in CLUSTERS)
        finite = np.isfinite(worst) and np.isfinite(errors.loss)
        yield Row(
            f"a step in {way.name}",
            FAMILY,
            f"loss {errors.loss:.1e}, gradients {worst:.1e}",
            f"both at most {bound:g}, finite",
            bool(finite) and worst <= bound and errors.loss <= bound,
        )


def transfer_rows() -> Iterator[Row]:
    """The sRGB transfer and its inverse over all magnitudes: finite, rising, with finite slopes."""
    size = np.float32(2.0) ** np.linspace(-120.0, 60.0, 20001, dtype=np.float32)
    near = (
        np.nextafter(np.float32(0.0031308), np.float32([0, 1])),
        np.nextafter(np.float32(0.04045), np.float32([0, 1])),
    )
    values = np.unique(np.concatenate([-size, [0.0, 1.0], size, *near])).astype(np.float32)
    for name, curve in (("sRGB transfer", srgb_from_linear), ("its inverse", linear_from_srgb)):
        for dtype in (torch.float64, torch.float32):
            at = torch.from_numpy(values[values < HIGHEST]).to(dtype).requires_grad_()
            out = curve(at)
            (slope,) = torch.autograd.grad(out.sum(), at)
            kind = str(dtype).removeprefix("torch.")
            yield _curve(f"{name}, {kind}", out.detach().numpy(), slope.numpy())
    pairs = np.array([kernel_srgb(value) for value in values], np.float64)
    yield _curve("sRGB transfer, numba", pairs[:, 0], pairs[:, 1])
    inverse = np.array([kernel_linear(value) for value in values[values < HIGHEST]], np.float64)
    yield _curve("its inverse, numba", inverse, np.ones(1))


def loss_row() -> Row:
    """Samples that all weigh nothing: loss and gradients are 0, and Adam moves nothing."""
    way = Way("float32", torch.float32)
    data = samples_for(way)
    samples = data.samples(next(optimise.batches(data.ranges, 512, seed=2)), torch.device("cpu"))
    weightless = type(samples)(
        samples.photo, samples.uv, samples.position, samples.colour, None, torch.zeros(512)
    )
    torch.manual_seed(0)
    model = optimise.Model(SPEC, PHOTOS)
    worst = abs(float(model_loss(model, weightless, TERMS).detach()))
    before = [parameter.detach().clone() for parameter in model.parameters()]
    for kind in (optimise.TorchStep, optimise.FusedStep):
        step = kind(model, TERMS, list(model.parameters()), 1e-2)
        loss, gradients = step.gradients(weightless)
        worst = max(
            [worst, abs(float(loss)), *(float(torch.as_tensor(g).abs().max()) for g in gradients.values())]
        )
        step.update(1.0)
    moved = max(float((a - b).detach().abs().max()) for a, b in zip(before, model.parameters(), strict=True))
    return Row(
        "a batch whose weights are all 0", FAMILY, f"loss, gradients {worst:g}; step {moved:g}", "all 0", worst == moved == 0.0
    )  # fmt: skip


def _problem(spec: GridSpec) -> tuple[HashGrid, torch.Tensor, torch.Tensor]:
    """A grid with values in [-1, 1], points (N, D) with all corners of the cube, and the levels' sum in float64."""
    torch.manual_seed(1)
    grid = HashGrid(spec)
    torch.nn.init.uniform_(grid.tables, -1.0, 1.0)
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * spec.dimensions)
    points = torch.cat([torch.rand(POINTS, spec.dimensions), corners])
    exact = (
        encode_reference(points.double(), grid.tables.detach().double(), spec).unflatten(1, (-1, 3)).sum(1)
    )
    return grid, points, exact


def _curve(name: str, out: np.ndarray, slope: np.ndarray) -> Row:
    falls = np.maximum(out[:-1] - out[1:], 0.0) / np.maximum(np.abs(out[:-1]), 1e-30)
    worst = float(falls.max())
    finite = bool(np.isfinite(out).all() and np.isfinite(slope).all() and (slope > 0.0).all())
    bound = 1e-15 if "float64" in name else 2e-6  # rounding
    measured = f"falls by {worst:.0e} of its value at most" + ("" if finite else "; not finite")
    return Row(f"{name}, from -1e18 to 1e15", FAMILY, measured, f"at most {bound:g}, slopes finite and positive", finite and worst <= bound)  # fmt: skip
