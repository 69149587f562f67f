"""Hash encodings of any resolution and table, and the number types of encodings, losses and gradients, against float64."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from dante_w.core.color import linear_from_srgb, srgb_from_linear
from dante_w.field.batches import batches
from dante_w.field.cpu.kernels.functions import linear_from_srgb as kernel_linear
from dante_w.field.cpu.kernels.functions import srgb_from_linear as kernel_srgb
from dante_w.field.cpu.step import CpuStep, decode_points
from dante_w.field.fields import FieldModel, FieldSpec
from dante_w.field.hash_encoding import GridSpec, HashGrid, encode_reference
from dante_w.field.loss import model_loss
from dante_w.field.optimise import Problem, Schedule, fit
from dante_w.field.settings import STANDARD
from dante_w.field.step import TorchStep
from measure.synthetic_scene import SphereSamples
from torch import nn

from extremes.row import Row

FAMILY = "encodings and number types"
#: The presets' shape with fewer and smaller tables: plain torch writes every table once per corner.
SPEC = FieldSpec(
    albedo=GridSpec(2, levels=8, features=2, coarsest=16, finest=512, log2_table=13),
    irradiance=GridSpec(3, levels=4, features=2, coarsest=4, finest=16, log2_table=12),
    hidden=32,
)
TERMS = STANDARD.terms(prior_weight=1.0, priors=False)
PHOTOS, SAMPLES_PER_PHOTO, BATCH = 8, 8192, 4096
#: Steps of the fit at whose end a step in float32 is held against one in float64, and how far they may be apart.
FITTED_STEPS, STEP_BOUND = 20, 1e-5
FEATURES = 3
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
    spec = GridSpec(
        dimensions, 4, FEATURES, 15, finest, log2_table
    )  # no powers of two: these round to nothing
    grid, points, exact = _problem(spec)
    found = decode_points(grid, _level_sum(spec), points, None).double().numpy()
    upstream = torch.linspace(-1.0, 1.0, exact.numel(), dtype=torch.float64).reshape(exact.shape)
    table = grid.tables.detach().double().requires_grad_()
    (wanted,) = torch.autograd.grad(
        encode_reference(points.double(), table, spec).unflatten(1, (-1, FEATURES)).sum(1), table, upstream
    )
    own = grid.tables
    (gradient,) = torch.autograd.grad(
        encode_reference(points, own, spec).unflatten(1, (-1, FEATURES)).sum(1), own, upstream.float()
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
    grid, points, exact = _problem(GridSpec(2, 4, FEATURES, 16, 4096, 14))
    tables = grid.tables.detach().to(dtype)
    found = encode_reference(points, tables, grid.spec).unflatten(1, (-1, FEATURES)).double().sum(1)
    error = float((found - exact).abs().max() / exact.abs().max())
    bound = 4.0 * torch.finfo(dtype).eps + 4096 * 2.0**-24
    name = str(dtype).removeprefix("torch.")
    return Row(
        f"grid up to 4096, tables in {name}", FAMILY, f"{error:.1e}", f"at most {bound:.1e}", error <= bound
    )


def step_rows() -> Iterator[Row]:
    """Loss and gradients of one step in float32 against float64, at a model that float64 has fitted."""
    torch.manual_seed(0)
    fitted, exact_samples = (
        FieldModel(SPEC, PHOTOS).double(),
        SphereSamples(PHOTOS, SAMPLES_PER_PHOTO, torch.float64),
    )
    schedule = Schedule(FITTED_STEPS, BATCH, learning_rate=1e-2)
    problem = Problem(fitted, exact_samples, exact_samples.ranges, TERMS)  # type: ignore[arg-type]
    fit(problem, schedule, 3, lambda *_: None)
    index = next(batches(exact_samples.ranges, BATCH, seed=2))
    exact_loss, exact = _gradients(TorchStep, fitted, exact_samples, index)
    samples = SphereSamples(PHOTOS, SAMPLES_PER_PHOTO, torch.float32)
    single = FieldModel(SPEC, PHOTOS)
    single.load_state_dict(fitted.state_dict())
    for name, kind in (("float32, torch", TorchStep), ("float32, numba", CpuStep)):
        loss, gradients = _gradients(kind, single, samples, index)
        error = abs(loss - exact_loss) / exact_loss
        worst = max(float((gradients[group] - exact[group]).norm() / exact[group].norm()) for group in exact)
        yield Row(
            f"a step in {name}",
            FAMILY,
            f"loss {error:.1e}, gradients {worst:.1e}",
            f"both at most {STEP_BOUND:g}, finite",
            bool(np.isfinite(worst) and np.isfinite(error)) and worst <= STEP_BOUND and error <= STEP_BOUND,
        )


def _gradients(
    kind: type[TorchStep | CpuStep], model: FieldModel, source: SphereSamples, index: np.ndarray
) -> tuple[float, dict[str, torch.Tensor]]:
    """Loss of a batch, and its gradients of tables, decoders and photos, each flat in float64."""
    samples = source.samples(index, torch.device("cpu"))
    loss, found = kind(model, TERMS, list(model.parameters()), 0.0).gradients(samples)
    parts: dict[str, list[torch.Tensor]] = {"tables": [], "decoders": [], "photos": []}
    for name, gradient in found.items():
        group = "tables" if name.endswith("tables") else "decoders" if ".decoder." in name else "photos"
        parts[group].append(torch.as_tensor(gradient).double().reshape(-1))
    return float(loss), {group: torch.cat(each) for group, each in parts.items()}


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
    source = SphereSamples(PHOTOS, SAMPLES_PER_PHOTO, torch.float32)
    samples = source.samples(next(batches(source.ranges, 512, seed=2)), torch.device("cpu"))
    weightless = type(samples)(
        samples.photo, samples.uv, samples.position, samples.colour, None, torch.zeros(512)
    )
    torch.manual_seed(0)
    model = FieldModel(SPEC, PHOTOS)
    worst = abs(float(model_loss(model, weightless, TERMS).detach()))
    before = [parameter.detach().clone() for parameter in model.parameters()]
    for kind in (TorchStep, CpuStep):
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


def _level_sum(spec: GridSpec) -> nn.Sequential:
    """A decoder whose output is the sum of the levels, exactly: its hidden units hold x and -x, max(x, 0) - max(-x, 0) = x."""
    identity = torch.eye(spec.width)
    one_level = torch.eye(spec.features).repeat(1, spec.levels)
    decoder = nn.Sequential(
        nn.Linear(spec.width, 2 * spec.width), nn.ReLU(), nn.Linear(2 * spec.width, spec.features)
    )
    with torch.no_grad():
        decoder[0].weight.copy_(torch.cat([identity, -identity]))
        decoder[2].weight.copy_(torch.cat([one_level, -one_level], dim=1))
        decoder[0].bias.zero_()
        decoder[2].bias.zero_()
    return decoder


def _problem(spec: GridSpec) -> tuple[HashGrid, torch.Tensor, torch.Tensor]:
    """A grid with values in [-1, 1], points (N, D) with all corners of the cube, and the levels' sum in float64."""
    torch.manual_seed(1)
    grid = HashGrid(spec)
    torch.nn.init.uniform_(grid.tables, -1.0, 1.0)
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * spec.dimensions)
    points = torch.cat([torch.rand(POINTS, spec.dimensions), corners])
    exact = (
        encode_reference(points.double(), grid.tables.detach().double(), spec)
        .unflatten(1, (-1, FEATURES))
        .sum(1)
    )
    return grid, points, exact


def _curve(name: str, out: np.ndarray, slope: np.ndarray) -> Row:
    falls = np.maximum(out[:-1] - out[1:], 0.0) / np.maximum(np.abs(out[:-1]), 1e-30)
    worst = float(falls.max())
    finite = bool(np.isfinite(out).all() and np.isfinite(slope).all() and (slope > 0.0).all())
    bound = 1e-15 if "float64" in name else 2e-6  # rounding
    measured = f"falls by {worst:.0e} of its value at most" + ("" if finite else "; not finite")
    return Row(f"{name}, from -1e18 to 1e15", FAMILY, measured, f"at most {bound:g}, slopes finite and positive", finite and worst <= bound)  # fmt: skip
