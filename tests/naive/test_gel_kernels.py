"""The gel's kernels against plain programs that find the same solutions in another way."""

import numpy as np
import pytest
from scipy.optimize import nnls

from spikingtac.sim.gel_solvers import (
    Influence,
    lateral_displacement_kernel,
    pressure_kernel,
    product_kernel,
    shear_kernel,
)
from spikingtac.sim.layer import GridConfig, LayerOperator

Array = np.ndarray

TABLES = LayerOperator(GridConfig(cells=16, span_mm=6.5), 3.0).tables


def influence(table: Array, rows: Array, columns: Array) -> Array:
    """Return the influence matrix by the definition: response at an offset modulo n."""
    n = len(table)
    out = np.empty((len(rows), len(rows)))
    for i in range(len(rows)):
        for j in range(len(rows)):
            out[i, j] = table[(rows[i] - rows[j]) % n, (columns[i] - columns[j]) % n]
    return out


def pressure(compliance: Array, indentation: Array) -> Array:
    """Solve the contact as a least-squares problem with p >= 0 (Lawson and Hanson)."""
    root = np.linalg.cholesky(compliance.astype(np.float64))
    return nnls(root.T, np.linalg.solve(root, indentation.astype(np.float64)))[0]


def shear(xx: Array, xy: Array, yy: Array, target: Array, bound: Array) -> Array:
    """Solve friction by projected gradient steps of fixed length."""
    compliance = np.block([[xx, xy], [xy.T, yy]]).astype(np.float64)
    length = 1.0 / np.linalg.eigvalsh(compliance)[-1]
    tau = np.zeros(target.shape)
    for _ in range(5_000):
        tau += length * (target - (compliance @ tau.ravel()).reshape(2, -1))
        tau *= np.minimum(1.0, bound / np.maximum(np.hypot(*tau), 1e-30))
    return tau


def chosen(influence_of: Influence, wanted: Array) -> tuple[Array, Array, Array]:
    """Return the leading parts of the matrices, and rows and columns of the slots."""
    influence_of.set_cells(wanted)
    count = len(influence_of.cells)
    rows, columns = np.divmod(influence_of.cells, 16)
    return np.ascontiguousarray(influence_of.matrices[:, :count, :count]), rows, columns


def patch(seed: int, count: int) -> tuple[Array, Array, Array]:
    """Return matrices over random cells of a 16 by 16 grid."""
    wanted = np.zeros(256, np.bool_)
    wanted[np.random.default_rng(seed).choice(256, count, replace=False)] = True
    return chosen(Influence(TABLES), wanted)


def test_influence_of_a_changing_set() -> None:
    rng = np.random.default_rng(0)
    changing = Influence(TABLES)
    wanted = np.zeros(256, np.bool_)
    for flips in (1, 40, 0, 5, 200, 256, 100, 3, 250, 60):
        wanted ^= np.isin(np.arange(256), rng.choice(256, flips, replace=False))
        matrices, rows, columns = chosen(changing, wanted)
        np.testing.assert_array_equal(np.sort(changing.cells), np.flatnonzero(wanted))
        for matrix, table in zip(matrices, TABLES, strict=True):
            expected = influence(table, rows, columns)
            np.testing.assert_allclose(matrix, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("count", "capacity"), [(0, 0), (1, 1), (17, 33), (300, 300)])
def test_products(count: int, capacity: int) -> None:
    rng = np.random.default_rng(12)
    xx, xy, yy = rng.normal(size=(3, capacity, capacity)).astype(np.float32)
    one, other = rng.normal(size=(2, count)).astype(np.float32)
    np.testing.assert_allclose(product_kernel(xx, one), xx[:count, :count] @ one, atol=1e-4)
    both = lateral_displacement_kernel(xx, xy, yy, np.stack((one, other)))
    whole = np.block(
        [[xx[:count, :count], xy[:count, :count]], [xy[:count, :count], yy[:count, :count]]]
    )
    expected = (whole @ np.concatenate((one, other))).reshape(2, -1)
    np.testing.assert_allclose(both, expected, atol=2e-4)


@pytest.mark.parametrize(("seed", "count"), [(4, 1), (5, 12), (6, 50)])
@pytest.mark.parametrize("warm", [False, True])
def test_pressure(seed: int, count: int, warm: bool) -> None:
    compliance = patch(seed, count)[0][3]
    rng = np.random.default_rng(seed)
    indentation = rng.normal(0.1, 0.3, count).astype(np.float32)
    found = (
        rng.uniform(-0.2, 1.0, count).astype(np.float32) if warm else np.zeros(count, np.float32)
    )
    assert pressure_kernel(compliance, indentation, found, 1e-6, 2000) < 2000
    np.testing.assert_allclose(found, pressure(compliance, indentation), atol=2e-5)


@pytest.mark.parametrize(("seed", "count"), [(8, 1), (9, 12), (10, 40)])
@pytest.mark.parametrize("warm", [False, True])
def test_shear(seed: int, count: int, warm: bool) -> None:
    xx, xy, yy = patch(seed, count)[0][:3]
    rng = np.random.default_rng(seed)
    target = rng.normal(0.2, 0.5, (2, count)).astype(np.float32)
    bound = np.maximum(rng.normal(0.05, 0.1, count), 0.0).astype(np.float32)
    found = np.zeros((2, count), np.float32)
    if warm:
        found += rng.normal(size=found.shape).astype(np.float32)
    assert shear_kernel(xx, xy, yy, target, bound, found, 1e-6, 5000) < 5000
    assert (np.hypot(*found) <= bound * (1.0 + 1e-5)).all()
    np.testing.assert_allclose(found, shear(xx, xy, yy, target, bound), atol=2e-4)
