"""The ringing add-on against an ODE solver, and the resonance it rings at."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from spikingtac.sim.gel.inertia import InertiaConfig, Ringing, shear_resonance_hz


def test_the_resonance_of_the_usual_gel() -> None:
    assert shear_resonance_hz(30.0, 3.0) == pytest.approx(456.4, abs=0.1)
    assert shear_resonance_hz(120.0, 3.0) == pytest.approx(2.0 * shear_resonance_hz(30.0, 3.0))


def test_following_an_uneven_path_equals_an_ode_solver() -> None:
    times = np.cumsum([0.0, 2e-4, 5e-4, 1e-4, 3e-4])
    places = np.array([0.0, 0.3, -0.2, 0.5, 0.5])
    rate, damping = 2.0 * np.pi * 460.0, 0.15

    def motion(t: float, state: np.ndarray) -> list[float]:
        pull = rate**2 * (np.interp(t, times, places) - state[0])
        return [state[1], pull - 2.0 * damping * rate * state[1]]

    ringing = Ringing(460.0, damping, (1,))
    for step in range(1, len(times)):
        got = ringing.step(times[step] - times[step - 1], places[step : step + 1])[0]
        exact = solve_ivp(motion, (0.0, times[step]), [0.0, 0.0], max_step=1e-6, rtol=1e-8)
        assert got == pytest.approx(exact.y[0, -1], abs=1e-5)


def test_a_sudden_release_rings_and_settles() -> None:
    ringing = Ringing(460.0, 0.15, (1,))
    for _ in range(2000):
        ringing.step(1e-4, np.ones(1))
    path = [float(ringing.step(1e-4, np.zeros(1))[0]) for _ in range(400)]
    overshoot = np.exp(-np.pi * 0.15 / np.sqrt(1.0 - 0.15**2))
    assert min(path) == pytest.approx(-overshoot, rel=0.05)
    assert abs(path[-1]) < 1e-4
    ringing.reset()
    assert ringing.step(1e-4, np.zeros(1))[0] == 0.0


def test_damping_must_be_weak() -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        InertiaConfig(damping=1.0)
