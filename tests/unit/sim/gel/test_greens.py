"""The four closed forms against a numeric solution of the layer's equations, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from spikingtac.sim.gel.greens import GridConfig, LayerOperator, layer_response

THICKNESS_MM = 3.0


def surface_response(k: float, h: float, shear: float, pressure: float) -> tuple[float, float]:
    """Solve equilibrium through the thickness by collocation, at unit modulus.

    Frame: z = 0 at the free surface, z = h at the bond, u_x = i U, s_xz = i S, exp(i k x).
    Unknowns U, w (along z), S, s_zz; incompressible: i k u_x + w' = 0.
    """

    def rates(_z: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, w, s, zz = y
        return np.stack([s - k * w, k * u, 4.0 * k**2 * u - k * zz, k * s])

    def ends(top: np.ndarray, bond: np.ndarray) -> np.ndarray:
        # Outward normal -z: traction along x is -s_xz = shear (i.e. -i S), along z -s_zz.
        return np.array([-top[2] - shear, -top[3] - pressure, bond[0], bond[1]])

    z = np.linspace(0.0, h, 200)
    solution = solve_bvp(rates, ends, z, np.zeros((4, len(z))), tol=1e-8, max_nodes=100_000)
    assert solution.success
    return solution.y[0, 0], solution.y[1, 0]


@pytest.mark.parametrize("kh", [0.05, 0.2, 0.5, 1.0, 2.0, 3.5, 5.0])
def test_closed_forms_equal_a_numeric_solution(kh: float) -> None:
    k = kh / THICKNESS_MM
    response = layer_response(np.array([k]), THICKNESS_MM)
    # shear = i S gives u_x = i U: the factor i cancels in the lateral response.
    lateral, normal_by_shear = surface_response(k, THICKNESS_MM, shear=1.0, pressure=0.0)
    lateral_by_pressure, normal = surface_response(k, THICKNESS_MM, shear=0.0, pressure=1.0)
    assert response.normal[0] == pytest.approx(normal, rel=1e-5)
    assert response.longitudinal[0] == pytest.approx(lateral, rel=1e-5)
    # u_x = i U = -i coupling under unit pressure; under traction i the normal is -(-i)(i) coupling.
    assert response.coupling[0] == pytest.approx(-lateral_by_pressure, rel=1e-5)
    assert response.coupling[0] == pytest.approx(-normal_by_shear, rel=1e-5)


@pytest.mark.parametrize("kh", [0.05, 0.5, 1.0, 5.0])
def test_transverse_shear_equals_a_numeric_solution(kh: float) -> None:
    k = kh / THICKNESS_MM
    z = np.linspace(0.0, THICKNESS_MM, 200)
    solution = solve_bvp(
        lambda _z, y: np.stack([y[1], k**2 * y[0]]),
        lambda top, bond: np.array([-top[1] - 1.0, bond[0]]),
        z,
        np.zeros((2, len(z))),
        tol=1e-8,
    )
    expected = solution.y[0, 0]
    assert layer_response(np.array([k]), THICKNESS_MM).transverse[0] == pytest.approx(
        expected, rel=1e-5
    )


def test_a_thick_layer_is_a_half_space() -> None:
    k = np.array([0.3, 1.0, 4.0])
    response = layer_response(k, 1000.0)
    np.testing.assert_allclose(response.normal, 0.5 / k, rtol=1e-12)
    np.testing.assert_allclose(response.longitudinal, 0.5 / k, rtol=1e-12)
    np.testing.assert_allclose(response.transverse, 1.0 / k, rtol=1e-12)
    np.testing.assert_allclose(response.coupling, 0.0, atol=1e-12)


def test_a_uniform_traction_shears_and_does_not_press_in() -> None:
    response = layer_response(np.array([0.0, 1e-7]), THICKNESS_MM)
    np.testing.assert_allclose(response.normal, 0.0, atol=1e-6)
    np.testing.assert_allclose(response.longitudinal, THICKNESS_MM, rtol=1e-6)
    np.testing.assert_allclose(response.transverse, THICKNESS_MM, rtol=1e-6)
    np.testing.assert_allclose(response.coupling, 0.0, atol=1e-6)


def test_long_waves_of_pressure_squeeze_the_gel_out() -> None:
    grid = GridConfig(cells=64, span_mm=400.0)
    operator = LayerOperator(grid, THICKNESS_MM)
    k = 2.0 * np.pi / grid.span_mm
    traction = np.zeros((3, 64, 64))
    traction[2] = np.cos(k * grid.axis_mm)[None, :]
    squeezed = 0.5 * THICKNESS_MM**2 * k * np.sin(k * grid.axis_mm)  # -(h²/2 mu) dp/dx
    moved = operator.displacements(traction)
    np.testing.assert_allclose(moved[0][0], squeezed, rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(moved[1], 0.0, atol=1e-12)


def test_tables_are_what_the_operator_does() -> None:
    rng = np.random.default_rng(7)
    grid = GridConfig(cells=16)
    operator = LayerOperator(grid, THICKNESS_MM)
    traction = rng.normal(size=(3, 16, 16))
    xx, xy, yy, zz, xz, yz = operator.tables
    signed = [[xx, xy, xz], [xy, yy, yz], [-xz, -yz, zz]]
    expected = np.zeros_like(traction)
    for row in range(16):
        for column in range(16):
            for out in range(3):
                for into in range(3):
                    shifted = np.roll(signed[out][into], (row, column), axis=(0, 1))
                    expected[out] += traction[into, row, column] * shifted
    np.testing.assert_allclose(operator.displacements(traction), expected, atol=1e-12)


def test_work_is_reciprocal_and_positive() -> None:
    rng = np.random.default_rng(7)
    operator = LayerOperator(GridConfig(cells=32), THICKNESS_MM)
    one, other = rng.normal(size=(2, 3, 32, 32))
    mutual = np.sum(one * operator.displacements(other))
    assert mutual == pytest.approx(np.sum(other * operator.displacements(one)), rel=1e-10)
    assert np.sum(one * operator.displacements(one)) > 0.0


def test_turning_the_traction_turns_the_displacement() -> None:
    rng = np.random.default_rng(7)
    operator = LayerOperator(GridConfig(cells=32), THICKNESS_MM)
    x, y, z = rng.normal(size=(3, 32, 32))
    turned = np.stack([-np.rot90(y, -1), np.rot90(x, -1), np.rot90(z, -1)])
    u, v, w = operator.displacements(np.stack([x, y, z]))
    expected = np.stack([-np.rot90(v, -1), np.rot90(u, -1), np.rot90(w, -1)])
    np.testing.assert_allclose(operator.displacements(turned), expected, atol=1e-10)


@pytest.mark.parametrize("bad", [{"cells": 7}, {"cells": 4}, {"span_mm": 0.0}])
def test_an_unfit_grid_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="it must be"):
        GridConfig(**bad)  # type: ignore[arg-type]
