"""The rig: vibration, pads, grasped probe, clock, and the arm."""

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.sim.optics import MarkerImage, SkinState
from spikingtac.sim.rig import probe as rod
from spikingtac.sim.rig.pad import pad_response, rigid_modes
from spikingtac.sim.rig.probe import Grasp, Probe, ProbeState, bushing_stiffness, rod_inertia
from spikingtac.sim.rig.rig import Rig, Vibration
from spikingtac.sim.rig.ur3 import UR3Twin
from spikingtac.sim.rig.walls import NoWall, PlaneWall
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_at


@pytest.mark.parametrize("dt_s", [0.0005, 0.004])
def test_rms_and_resonance_do_not_depend_on_the_step(dt_s: float) -> None:
    vibration = Vibration(0.03, np.random.default_rng(1))
    path = np.array([vibration.advance(dt_s) for _ in range(round(30.0 / dt_s))])
    assert path.std() == pytest.approx(0.03, rel=0.1)
    power = np.abs(np.fft.rfft(path, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(path), dt_s)
    low, high = (power[(frequency > a) & (frequency < b)].mean() for a, b in ((13, 17), (0, 5)))
    assert low > 8.0 * high
    assert np.abs(np.corrcoef(path.T) - np.eye(3)).max() < 0.2


def test_the_patch_moves_rigidly_and_the_rim_follows_less() -> None:
    points = np.array([[0.0, 8.0], [3.0, 0.0], [5.0, 0.0], [12.0, 0.0]])
    displacement, _ = pad_response(points)
    np.testing.assert_allclose(displacement[:, :2], rigid_modes(points[:2]), atol=1e-12)
    lateral = displacement[0, :, 0]
    assert 1.0 > lateral[2] > 0.3
    assert abs(lateral[3]) < 0.1


NEAR_WALL = PlaneWall(point_mm=(0.375, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
DT_S = 1e-3


def drive(probe: Probe, path_mm: np.ndarray) -> list[ProbeState]:
    return [probe.step(1000 * (k + 1), DT_S, point) for k, point in enumerate(path_mm)]


@pytest.fixture
def rod_of(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Change constants of the rod for one test."""

    def change(**constants: object) -> None:
        rod.step_matrices.cache_clear()
        for name, value in constants.items():
            monkeypatch.setattr(rod, name, value)

    yield change
    rod.step_matrices.cache_clear()


NO_CREEP = {"CREEP_FRACTIONS": np.empty(0), "CREEP_TIMES_S": np.empty(0)}


def test_tip_stiffness_is_that_of_translation_and_rotation_in_series(rod_of) -> None:
    rod_of(GRAMS_PER_MM=0.0, **NO_CREEP)
    probe = Probe(Grasp(), NEAR_WALL, np.zeros(3))
    state = drive(probe, np.linspace(np.zeros(3), [1.0, 0.0, 0.0], 200))[-1]
    compliance = 1.0 / 2.5 + 40.0**2 / 68.0
    assert -state.force_n[0] == pytest.approx(1.0 / compliance, rel=1e-6)
    assert -state.bushing[0] == pytest.approx(0.017, abs=5e-4)
    assert state.bushing[5] == pytest.approx(0.0246, abs=1e-4)
    np.testing.assert_allclose(state.tip_mm, 0.0, atol=1e-9)


def test_creep_relaxes_the_force_as_the_kelvin_chain_says(rod_of) -> None:
    share, tau_s = 0.2, 0.05
    chain = {"CREEP_FRACTIONS": np.array([share]), "CREEP_TIMES_S": np.array([tau_s])}
    rod_of(GRAMS_PER_MM=0.0, **chain)
    probe = Probe(Grasp(), NEAR_WALL, np.zeros(3))
    hold = np.tile([1.0, 0.0, 0.0], (400, 1))
    force = np.array([-state.force_n[0] for state in drive(probe, hold)])
    time_s = DT_S * np.arange(1, 401)
    rate = (1.0 + share) / tau_s
    exact = (1.0 + share * np.exp(-rate * time_s)) / (1.0 + share) / (0.4 + 1600.0 / 68.0)
    np.testing.assert_allclose(force, exact, rtol=0.01)


def test_the_free_rod_rocks_at_the_frequency_of_its_inertia(rod_of) -> None:
    rod_of(DAMPING_RATIO=0.0, **NO_CREEP)
    grasp = Grasp()
    mass, stiffness = rod_inertia(), np.diag(bushing_stiffness(grasp))
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real) / (2 * np.pi)
    probe = Probe(grasp, NoWall(), np.zeros(3))
    dt_s, path = 1e-4, []
    for k in range(5000):
        path.append(probe.step(100 * (k + 1), dt_s, np.array([0.01 * (k > 0), 0, 0])).bushing[5])
    crossing = np.flatnonzero(np.diff(np.sign(path[1500:])) != 0)
    measured_hz = (len(crossing) - 1) / 2 / (dt_s * (crossing[-1] - crossing[0]))
    assert measured_hz == pytest.approx(modes.min(), rel=0.03)


WALL = PlaneWall(point_mm=(1.375, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
PX_PER_MM = 15.5


class PlainFinger:
    """A pinhole without lens, and a camera that reports one event per image."""

    def __init__(self) -> None:
        self.images: list[MarkerImage] = []
        self.optics = self.camera = self

    def project(self, state: SkinState) -> MarkerImage:
        count = len(state.marker_mm)
        center = PX_PER_MM * state.marker_mm[:, :2]
        return MarkerImage(state.t_us, center, np.tile(np.eye(2), (count, 1, 1)), np.ones(count))

    def settle(self, image: MarkerImage) -> None:
        self.images = [image]

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        start_us = self.images[-1].t_us
        self.images += images
        times_us = [image.t_us - 1 for image in images]
        return packet_at(times_us, (start_us, images[-1].t_us), (320, 320))


def make_rig(rms_mm: float = 0.0) -> Rig:
    finger: Any = PlainFinger()
    rng = np.random.default_rng(1)
    return Rig(UR3Twin(np.zeros(3), rng), WALL, finger, rng, vibration_mm=rms_mm)


def test_the_first_touch_is_where_the_tip_meets_the_wall() -> None:
    rig = make_rig()
    rig.arm.move_linear(np.array([3.0, 0.0, 0.0]), 5.0)
    while rig.first_contact is None:
        rig.advance(1000)
    assert rig.first_contact.arm_mm[0] == pytest.approx(1.0, abs=0.002)
    assert rig.t_us - 1000 <= rig.first_contact.t_us <= rig.t_us
    at_touch = rig.arm.position_at_mm(rig.first_contact.t_us)
    np.testing.assert_allclose(at_touch, rig.first_contact.arm_mm, atol=0.002)


def test_equal_seeds_and_any_pull_of_whole_steps_give_equal_states() -> None:
    ends = []
    for pulls in ([1000] * 60, [3000] * 20):
        rig = make_rig(rms_mm=0.03)
        rig.arm.move_linear(np.array([3.0, 0.0, 0.0]), 50.0)
        for dt_us in pulls:
            rig.advance(dt_us)
        ends.append((rig.state.tip_mm, rig.state.bushing, rig.image.center_px))
    for first, second in zip(*ends, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-12)


FAST_MM_S = 180.0


def approaching(rng: np.random.Generator, kind: type[UR3Twin] = UR3Twin) -> UR3Twin:
    """Return an arm that cruises at 0.18 m/s along x, at a random phase of its cycle."""
    arm = kind(np.zeros(3), rng, repeatability_mm=0.0)
    arm.move_linear(np.array([300.0, 0.0, 0.0]), FAST_MM_S)
    arm.advance_to(int(rng.integers(600_000, 700_000)))
    return arm


def overshoots_mm(kind: type[UR3Twin]) -> np.ndarray:
    rng, found = np.random.default_rng(1), []
    for _ in range(800):
        arm = approaching(rng, kind)
        touched_mm = arm.true_position_mm()[0]
        arm.stop()
        arm.advance_to(1_500_000)
        found.append(arm.true_position_mm()[0] - touched_mm)
    return np.array(found)


@pytest.mark.parametrize(
    ("changes", "mean_mm", "worst_mm"),
    [({}, 6.2, 7.6), ({"CYCLE_S": 0.002, "JERK_MM_S3": np.inf}, 4.2, 5.1)],
)
def test_overshoot_of_a_perfect_sensor(
    changes: dict[str, float], mean_mm: float, worst_mm: float
) -> None:
    found = overshoots_mm(type("Changed", (UR3Twin,), changes))
    assert found.mean() == pytest.approx(mean_mm, abs=0.1)
    assert found.max() == pytest.approx(worst_mm, abs=0.15)
    assert found.max() <= worst_mm + 0.05


def test_the_reported_pose_is_up_to_one_cycle_old() -> None:
    rng = np.random.default_rng(2)
    arms = [approaching(rng) for _ in range(400)]
    lag = np.array([(arm.pose().position_mm - arm.true_position_mm())[0] for arm in arms])
    assert lag.mean() == pytest.approx(-0.72, abs=0.05)
    assert lag.min() >= -1.44 - 1e-6
    assert lag.max() <= 1e-9


def test_a_machine_without_ruckig_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[arm\]"):
        UR3Twin(np.zeros(3), np.random.default_rng(0)).move_linear(np.ones(3), 50.0)
