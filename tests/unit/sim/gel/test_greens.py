"""The four closed forms against a numeric solution of the layer's equations, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from spikingtac.sim.layer import GridConfig, LayerOperator, layer_response

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
