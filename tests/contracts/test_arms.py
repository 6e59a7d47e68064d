"""What every arm does, whether it is the twin or a driver on a controller."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.ur import open_arm
from spikingtac.sim.rig.ur3 import UR3Twin
from stand_ins.remote_arm import RemoteArm
from stand_ins.ur_controller import URController

pytestmark = pytest.mark.waits

REPEATS_WITHIN_MM = 0.2
PATIENCE_S = 20.0
FAR_MM = 800.0  # An arm on its way there is still under way when a slow machine has done its part.


@dataclass
class Workplace:
    """An arm at rest, and how time passes for it."""

    arm: Arm
    wait_s: Callable[[float], None]

    def wait_until(self, done: Callable[[], bool]) -> None:
        for _ in range(round(PATIENCE_S / 0.01)):
            if done():
                return
            self.wait_s(0.01)
        pytest.fail("it did not come")

    def wait_until_idle(self) -> None:
        self.wait_until(lambda: self.arm.state() is not ArmState.MOVING)


def twin() -> Iterator[Workplace]:
    arm = UR3Twin(np.array([100.0, 200.0, 300.0]), np.random.default_rng(1))
    now_us = 0

    def wait_s(duration_s: float) -> None:
        nonlocal now_us
        now_us += round(duration_s * 1e6)
        arm.advance_to(now_us)

    wait_s(0.1)
    yield Workplace(arm, wait_s)


def driver() -> Iterator[Workplace]:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController() as controller, RemoteArm(controller.host) as arm:
        yield Workplace(arm, time.sleep)


def opened() -> Iterator[Workplace]:
    arm = open_arm("twin:")
    time.sleep(0.02)
    yield Workplace(arm, time.sleep)


@pytest.fixture(params=[twin, opened, driver], ids=["twin", "twin:", "ur"])
def place(request: pytest.FixtureRequest) -> Iterator[Workplace]:
    yield from request.param()


def test_it_moves_in_a_straight_line_to_its_target_and_keeps_its_rotation(place: Workplace) -> None:
    start = place.arm.pose()
    target = start.position_mm + np.array([30.0, -40.0, 0.0])
    place.arm.move_linear(target, 50.0)
    assert place.arm.state() is ArmState.MOVING
    path = []
    while place.arm.state() is ArmState.MOVING:
        path.append(place.arm.pose().position_mm)
        place.wait_s(0.01)
    across = np.cross(np.array(path) - start.position_mm, [0.6, -0.8, 0.0])
    assert np.abs(across).max() < REPEATS_WITHIN_MM
    end = place.arm.pose()
    np.testing.assert_allclose(end.position_mm, target, atol=REPEATS_WITHIN_MM)
    np.testing.assert_allclose(end.rotation, start.rotation, atol=1e-6)


def test_a_stop_ends_the_motion_on_its_line(place: Workplace) -> None:
    start = place.arm.pose().position_mm
    place.arm.move_linear(start + np.array([0.0, 0.0, FAR_MM]), 100.0)
    place.wait_until(lambda: place.arm.pose().position_mm[2] - start[2] > 5.0)
    place.arm.stop()
    place.wait_until_idle()
    moved = place.arm.pose().position_mm - start
    assert 5.0 < moved[2] < FAR_MM / 2
    assert np.abs(moved[:2]).max() < REPEATS_WITHIN_MM
    np.testing.assert_allclose(place.arm.speed_mm_s(), 0.0, atol=0.5)


def test_a_stop_at_rest_is_harmless_and_motion_goes_on_afterwards(place: Workplace) -> None:
    assert isinstance(place.arm, Arm)
    place.arm.stop()
    place.wait_s(0.05)
    place.wait_until_idle()
    target = place.arm.pose().position_mm + np.array([1.0, 0.0, 0.0])
    place.arm.move_linear(target, 20.0)
    place.wait_until_idle()
    np.testing.assert_allclose(place.arm.pose().position_mm, target, atol=REPEATS_WITHIN_MM)


def test_a_motion_during_a_motion_is_refused(place: Workplace) -> None:
    start = place.arm.pose().position_mm
    place.arm.move_linear(start + np.array([FAR_MM, 0.0, 0.0]), 20.0)
    with pytest.raises(DeviceError, match="cannot start"):
        place.arm.move_linear(start, 20.0)
    place.arm.stop()
    place.wait_until_idle()


@pytest.mark.parametrize(
    ("target", "speed", "words"),
    [
        ([0.0, 0.0], 10.0, "three finite numbers"),
        ([0.0, np.nan, 0.0], 10.0, "three finite numbers"),
        ([0.0, 0.0, 0.0], 0.0, "speed"),
        ([0.0, 0.0, 0.0], 1e6, "speed"),
    ],
)
def test_impossible_motions_are_refused(
    place: Workplace, target: list[float], speed: float, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        place.arm.move_linear(np.array(target), speed)
    assert place.arm.state() is ArmState.IDLE


def test_a_closed_arm_says_so(place: Workplace) -> None:
    place.arm.close()
    place.arm.close()
    assert place.arm.state() is ArmState.DISCONNECTED
    with pytest.raises(DeviceError):
        place.arm.move_linear(np.zeros(3), 10.0)
    with pytest.raises(DeviceError):
        place.arm.pose()


@pytest.mark.parametrize("address", ["", "twin", "twin:finger"])
def test_an_address_without_arm_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="valid: twin:, or the address of a UR arm"):
        open_arm(address)
