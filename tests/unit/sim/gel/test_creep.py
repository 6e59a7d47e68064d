"""The creep chain against the analytic Kelvin chain, and the residual that it predicts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from spikingtac.sim.gel.gel import CreepChain, SpectrumConfig

SPECTRUM = SpectrumConfig()
FRACTIONS, TIMES = np.array(SPECTRUM.fractions), np.array(SPECTRUM.times_s)


def held(chain: CreepChain, displacement: float, duration_s: float, dt_s: float) -> float:
    """Hold a displacement, and return the last traction (per J0)."""
    traction = 0.0
    for _ in range(round(duration_s / dt_s)):
        traction = (displacement - float(chain.history(dt_s))) / chain.compliance(dt_s)
        chain.advance(dt_s, np.array(traction))
    return traction


def test_creep_under_a_constant_traction_is_the_kelvin_chain() -> None:
    chain = CreepChain(SPECTRUM, ())
    t = 0.0
    for dt_s in (0.001, 0.02, 0.5, 0.004, 10.0):
        strain = float(chain.history(dt_s)) + chain.compliance(dt_s) * 2.0
        chain.advance(dt_s, np.array(2.0))
        t += dt_s
        exact = 2.0 * (1.0 + FRACTIONS @ (1.0 - np.exp(-t / TIMES)))
        assert strain == pytest.approx(exact, rel=1e-12)


def test_relaxation_and_residual_equal_an_ode_solver() -> None:
    solution = solve_ivp(
        lambda _t, w: (FRACTIONS * (12.0 - w.sum()) - w) / TIMES,
        (0.0, 5.0),
        np.zeros(3),
        method="LSODA",
        rtol=1e-10,
        atol=1e-12,
    )
    stored = solution.y[:, -1]
    chain = CreepChain(SPECTRUM, ())
    traction = held(chain, 12.0, 5.0, dt_s=0.0005)
    assert traction == pytest.approx(12.0 - stored.sum(), rel=1e-4)
    for t in (0.1, 1.0, 2.0, 5.0):
        assert float(chain.history(t)) == pytest.approx(stored @ np.exp(-t / TIMES), rel=1e-3)
