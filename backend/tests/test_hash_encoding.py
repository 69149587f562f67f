"""The hash encoding against instant-NGP's definition, in values and gradients, in torch and in the kernels."""

import numpy as np
import pytest
import torch
from dante_w.field.cpu.kernels import BLOCK
from dante_w.field.cpu.kernels.grid import Grid, encode, load, scatter
from dante_w.field.hash_encoding import PRIMES, GridSpec, HashGrid, encode_reference, vertex_index
from hypothesis import given, settings
from hypothesis import strategies as st

SPECS = [
    GridSpec(2, levels=4, features=2, coarsest=3, finest=40, log2_table=8),
    GridSpec(3, levels=4, features=2, coarsest=2, finest=17, log2_table=9),
    GridSpec(2, levels=1, features=3, coarsest=5, finest=5, log2_table=4),
]


def brute_force(point: np.ndarray, tables: np.ndarray, spec: GridSpec) -> list[float]:
    """Eq. 2 to 4 of the paper for one point, in plain Python integers and floats."""
    result, start = [], 0
    for resolution, entries in zip(spec.resolutions, spec.entries, strict=True):
        side = resolution + 1
        place = [c * resolution for c in point]
        low = [min(int(c), side - 2) for c in place]
        features = np.zeros(spec.features)
        for corner in range(2**spec.dimensions):
            bits = [(corner >> axis) & 1 for axis in range(spec.dimensions)]
            weight = 1.0
            for axis, bit in enumerate(bits):
                fraction = place[axis] - low[axis]
                weight *= fraction if bit else 1.0 - fraction
            vertex = [a + b for a, b in zip(low, bits, strict=True)]
            if side**spec.dimensions <= entries:
                entry = sum(v * side**axis for axis, v in enumerate(vertex))
            else:
                entry = 0
                for v, prime in zip(vertex, PRIMES, strict=False):
                    entry ^= v * prime
                entry %= entries
            features += weight * tables[start + entry]
        result.extend(features)
        start += entries
    return result


@pytest.mark.parametrize("spec", SPECS)
def test_the_reference_follows_the_definition(spec):
    grid = HashGrid(spec, torch.float64)
    torch.nn.init.normal_(grid.tables)
    edges = torch.tensor([[0.0] * spec.dimensions, [1.0] * spec.dimensions], dtype=torch.float64)
    points = torch.cat([torch.rand(200, spec.dimensions, dtype=torch.float64), edges])
    expected = [brute_force(p, grid.tables.detach().numpy(), spec) for p in points.numpy()]
    torch.testing.assert_close(grid(points), torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize("spec", SPECS)
def test_gradcheck(spec):
    points = torch.rand(7, spec.dimensions, dtype=torch.float64)
    tables = torch.randn(sum(spec.entries), spec.features, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: encode_reference(points, t, spec), tables)


@pytest.mark.parametrize("count", [1, BLOCK, 1000])
@pytest.mark.parametrize("spec", SPECS)
def test_the_kernels_encode_and_transpose_like_the_reference(spec, count):
    tables, points = torch.randn(sum(spec.entries), spec.features), torch.rand(count, spec.dimensions)
    upstream = torch.randn(count, spec.width)
    exact = tables.double().requires_grad_()
    encoded = encode_reference(points.double(), exact, spec)
    encoded.backward(upstream.double())
    ours, gradient = by_kernels(spec, tables.numpy(), points.numpy(), upstream.numpy())
    torch.testing.assert_close(torch.from_numpy(ours).double(), encoded.detach(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(torch.from_numpy(gradient).double(), exact.grad, rtol=1e-4, atol=1e-3)


def by_kernels(
    spec: GridSpec, tables: np.ndarray, points: np.ndarray, upstream: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The encoding (N, L * F), block by block, and the tables' gradient for upstream gradients (N, L * F)."""
    offsets = np.cumsum([0, *spec.entries])
    grid = Grid(tables, np.array(spec.resolutions, np.float32), offsets)
    blocks = -(-len(points) // BLOCK)
    encoded, rows = np.empty((2, blocks, spec.width, BLOCK), np.float32)
    entry, weight = (np.empty((2**spec.dimensions, BLOCK), kind) for kind in (np.uint32, np.float32))
    block = np.empty((spec.dimensions, BLOCK), np.float32)
    for n in range(blocks):
        load(points, n * BLOCK, block)
        encode(grid, block, entry, weight, encoded[n])
        part = upstream[n * BLOCK : (n + 1) * BLOCK]
        rows[n, :, : len(part)] = part.T
    gradient = np.zeros_like(tables)
    for level, resolution in enumerate(grid.resolutions):
        own = gradient[offsets[level] : offsets[level + 1]]
        scatter(points, resolution, rows, level * spec.features, own)
    return encoded.transpose(0, 2, 1).reshape(-1, spec.width)[: len(points)], gradient


@given(st.integers(1, 64), st.integers(1, 2000), st.integers(1, 16))
def test_resolutions_grow_from_coarsest_to_finest(coarsest, growth, levels):
    spec = GridSpec(2, levels, 2, coarsest, coarsest + growth, 10)
    assert spec.resolutions[0] == coarsest
    assert spec.resolutions[-1] == (coarsest + growth if levels > 1 else coarsest)
    assert spec.resolutions == sorted(spec.resolutions)


def test_the_released_reference_has_these_resolutions():
    spec = GridSpec(2, 16, 2, 16, 2048, 22)
    ratio = 2048 / 16
    assert spec.resolutions == [int(16 * ratio ** (i / 15) + 1e-9) for i in range(16)]
    assert spec.resolutions[1] / spec.resolutions[0] == pytest.approx(1.38, abs=0.07)
    assert spec.entries[-1] == 2**22 and spec.entries[0] == 17**2


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2), st.floats(-5.0, 5.0))
def test_equal_tables_encode_every_point_alike(point, value):
    grid = HashGrid(SPECS[0], torch.float64)
    torch.nn.init.constant_(grid.tables, value)
    encoded = grid(torch.tensor([point], dtype=torch.float64))
    torch.testing.assert_close(encoded, torch.full_like(encoded, value))


def test_points_outside_and_nan_count_as_the_edge():
    spec = SPECS[0]
    grid = HashGrid(spec, torch.float64)
    odd = torch.tensor([[-3.0, 0.5], [7.0, 0.5], [float("nan"), 0.5]], dtype=torch.float64)
    edge = torch.tensor([[0.0, 0.5], [1.0, 0.5], [0.0, 0.5]], dtype=torch.float64)
    torch.testing.assert_close(grid(odd), grid(edge))
    tables, upstream = grid.tables.detach().float().numpy(), np.zeros((3, spec.width), np.float32)
    by_edge, by_odd = (
        by_kernels(spec, tables, points.float().numpy(), upstream)[0] for points in (edge, odd)
    )
    np.testing.assert_array_equal(by_odd, by_edge)


def test_hashed_entries_stay_in_the_table():
    vertex = torch.randint(0, 70000, (1000, 3))
    index = vertex_index(vertex, 65537, 1 << 12)
    assert int(index.min()) >= 0 and int(index.max()) < 1 << 12
