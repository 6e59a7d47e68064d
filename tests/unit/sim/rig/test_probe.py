"""The grasped probe against closed forms: compliance, creep, friction, inertia."""

import numpy as np
import pytest

from spikingtac.sim.rig.probe import Probe, ProbeConfig, ProbeState, bushing_stiffness, rod_inertia
from spikingtac.sim.rig.walls import NoWall, PlaneWall, Wall

WALL = PlaneWall(point_mm=(0.375, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
STILL = ProbeConfig(grams_per_mm=0.0, creep=())
DT_S = 1e-3


def drive(probe: Probe, path_mm: np.ndarray) -> list[ProbeState]:
    return [probe.step(1000 * (k + 1), DT_S, point) for k, point in enumerate(path_mm)]


def line(start: tuple[float, ...], end: tuple[float, ...], steps: int = 200) -> np.ndarray:
    return np.linspace(start, end, steps)


def pressed(config: ProbeConfig, wall: Wall = WALL, to: tuple[float, ...] = (1.0, 0.0, 0.0)):
    return drive(Probe(config, wall, np.zeros(3)), line((0.0, 0.0, 0.0), to))[-1]


def test_tip_stiffness_is_that_of_translation_and_rotation_in_series() -> None:
    state = pressed(STILL)
    compliance = 1.0 / 2.5 + 40.0**2 / 68.0
    assert -state.force_n[0] == pytest.approx(1.0 / compliance, rel=1e-6)
    assert -state.bushing[0] == pytest.approx(0.017, abs=5e-4)
    assert state.bushing[5] == pytest.approx(0.0246, abs=1e-4)
    np.testing.assert_allclose(state.tip_mm, 0.0, atol=1e-9)


def test_creep_relaxes_the_force_as_the_kelvin_chain_says() -> None:
    chain = ((0.2, 0.05),)
    probe = Probe(ProbeConfig(grams_per_mm=0.0, creep=chain), WALL, np.zeros(3))
    hold = np.tile([1.0, 0.0, 0.0], (400, 1))
    force = np.array([-state.force_n[0] for state in drive(probe, hold)])
    time_s = DT_S * np.arange(1, 401)
    share, tau_s = chain[0]
    rate = (1.0 + share) / tau_s
    exact = (1.0 + share * np.exp(-rate * time_s)) / (1.0 + share) / (0.4 + 1600.0 / 68.0)
    np.testing.assert_allclose(force, exact, rtol=0.01)


def test_the_free_rod_rocks_at_the_frequency_of_its_inertia() -> None:
    config = ProbeConfig(creep=(), damping_ratio=0.0)
    mass, stiffness = rod_inertia(config), np.diag(bushing_stiffness(config))
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real) / (2 * np.pi)
    probe = Probe(config, NoWall(), np.zeros(3))
    dt_s, path = 1e-4, []
    for k in range(5000):
        jolt = np.array([1.0, 0.0, 0.0]) * (k > 0) * 0.01
        path.append(probe.step(100 * (k + 1), dt_s, jolt).bushing[5])
    crossing = np.flatnonzero(np.diff(np.sign(path[1500:])) != 0)
    measured_hz = (len(crossing) - 1) / 2 / (dt_s * (crossing[-1] - crossing[0]))
    assert measured_hz == pytest.approx(modes.min(), rel=0.03)
