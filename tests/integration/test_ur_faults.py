"""The real driver against a fake controller that fails: everything ends in a stop and an error."""

import os
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.robot.arm import ArmState
from spikingtac.robot.ur import URArm
from spikingtac.robot.watchdog import Health, Watchdog, WatchdogConfig, WatchdogThread
from stand_ins.remote_arm import RemoteArm
from stand_ins.ur_controller import URController

pytestmark = pytest.mark.waits

# What a loaded machine may add to a stated time; 0.3 holds on an idle one.
SLACK_S = float(os.environ.get("SPIKINGTAC_SLACK_S", "5"))

# So far that an arm at 40 mm/s is still under way when a slow machine has done its part.
FAR_MM = 800.0
PATIENCE_S = 60.0

# Ten times what a robot would be given, so that a busy machine's own pauses are no silence.
STALE_S = 0.5


def until(done: Callable[[], bool], patience_s: float = PATIENCE_S) -> float:
    """Wait until ``done`` and return for how long; fail when it does not come."""
    start_s = time.monotonic()
    while not done():
        assert time.monotonic() - start_s < patience_s, "it did not come"
        time.sleep(0.005)
    return time.monotonic() - start_s


@pytest.fixture
def controller() -> Iterator[URController]:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController() as fake:
        yield fake


@pytest.fixture
def arm(controller: URController) -> Iterator[RemoteArm]:
    """Return a driver whose arm is moving."""
    with RemoteArm(controller.host) as driver:
        driver.move_linear(driver.pose().position_mm + np.array([FAR_MM, 0.0, 0.0]), 40.0)
        until(lambda: float(np.linalg.norm(driver.speed_mm_s())) > 30.0)
        yield driver


def still(controller: URController) -> bool:
    return float(np.linalg.norm(controller.twin.speed_mm_s())) < 0.1


@pytest.mark.parametrize(("e_series", "rate_hz"), [(False, 125.0), (True, 500.0)])
def test_both_series_are_driven_at_their_rate(e_series: bool, rate_hz: float) -> None:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController(e_series) as controller, RemoteArm(controller.host) as arm:
        assert controller.asked_rates_hz == [rate_hz, rate_hz]
        assert "rtde_set_watchdog" in controller.scripts[0]
        target = arm.pose().position_mm + np.array([1.0, 0.0, 0.0])
        arm.move_linear(target, 20.0)
        until(lambda: arm.state() is ArmState.IDLE)
        np.testing.assert_allclose(arm.pose().position_mm, target, atol=0.05)


def test_the_controller_stops_when_this_computer_dies(
    controller: URController, arm: RemoteArm
) -> None:
    arm.kill()
    assert until(lambda: still(controller)) < 0.1 + 0.05 + SLACK_S
    assert controller.twin.true_position_mm()[0] < 100.0 + FAR_MM - 10.0


def test_the_arm_stops_when_the_event_stream_dies(controller: URController) -> None:
    config = WatchdogConfig(stale_s=STALE_S)
    with RemoteArm(controller.host) as arm:
        watchdog = Watchdog(config, arm.stop, time.monotonic)
        watchdog.self_test()
        until(lambda: arm.state() is ArmState.IDLE)
        arm.move_linear(arm.pose().position_mm + np.array([FAR_MM, 0.0, 0.0]), 40.0)
        watchdog.arm()
        with WatchdogThread(watchdog):
            until(lambda: watchdog.beat() or not still(controller))
            died_s = time.monotonic()
            until(lambda: still(controller))
        told_s = controller.stop_times_s[-1] - died_s
        assert watchdog.health is Health.STALE
        assert told_s < STALE_S + 0.002 + SLACK_S
        assert watchdog.stop_failure is None


def test_a_protective_stop_is_seen_and_refuses_motion(
    controller: URController, arm: RemoteArm
) -> None:
    controller.protective_stop()
    until(lambda: arm.state() is ArmState.PROTECTIVE_STOP, 0.5 + SLACK_S)
    with pytest.raises(DeviceError, match="protective stop"):
        arm.move_linear(np.zeros(3), 10.0)


def test_a_stalled_stream_is_no_pose_and_can_still_be_stopped(
    controller: URController, arm: RemoteArm
) -> None:
    controller.stalled = True
    until(lambda: arm.state() is ArmState.DISCONNECTED, 0.1 + SLACK_S)
    with pytest.raises(DeviceError, match="no report from the controller"):
        arm.pose()
    arm.stop()
    until(lambda: "spikingtac_stop" in controller.scripts[-1], 0.2 + SLACK_S)
    controller.stalled = False
    until(lambda: still(controller))


def test_a_lost_controller_is_reported_at_once_and_found_again(
    controller: URController, arm: RemoteArm
) -> None:
    controller.shut_down()
    until(lambda: arm.state() is ArmState.DISCONNECTED, 0.1 + SLACK_S)
    start_s = time.monotonic()
    arm.stop()
    with pytest.raises(DeviceError, match=r"nothing is heard of the arm.* no script could be sent"):
        arm.confirm_stop()
    assert time.monotonic() - start_s < 0.2 + SLACK_S
    until(lambda: controller.twin.state() is ArmState.PROTECTIVE_STOP)
    controller.start_again()
    controller.twin.recover()
    arm.reconnect()
    until(lambda: arm.state() is ArmState.IDLE)
    target = arm.pose().position_mm + np.array([1.0, 0.0, 0.0])
    arm.move_linear(target, 20.0)
    until(lambda: arm.state() is ArmState.IDLE)
    np.testing.assert_allclose(arm.pose().position_mm, target, atol=0.05)
    assert arm.end() == 0


def test_nobody_there() -> None:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with pytest.raises(DeviceError, match="no UR controller answers"):
        RemoteArm("127.255.255.1")


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rtde_control", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[robot\]"):
        URArm("127.0.0.1")
