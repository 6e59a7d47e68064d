"""The creep chain against the analytic Kelvin chain, and the residual that it predicts."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.sim.gel import CreepChain, SpectrumConfig

SPECTRUM = SpectrumConfig()
FRACTIONS, TIMES = np.array(SPECTRUM.fractions), np.array(SPECTRUM.times_s)


def test_creep_under_a_constant_traction_is_the_kelvin_chain() -> None:
    chain = CreepChain(SPECTRUM, ())
    t = 0.0
    for dt_s in (0.001, 0.02, 0.5, 0.004, 10.0):
        strain = float(chain.history(dt_s)) + chain.compliance(dt_s) * 2.0
        chain.advance(dt_s, np.array(2.0))
        t += dt_s
        exact = 2.0 * (1.0 + FRACTIONS @ (1.0 - np.exp(-t / TIMES)))
        assert strain == pytest.approx(exact, rel=1e-12)
