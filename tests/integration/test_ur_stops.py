"""A stop is believed when the arm's own speed says so; calls have limits; faults are told.

The controller here acknowledges a means to stop and moves on, fails, or falls silent with its
connections open.
"""

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.robot.arm import ArmState
from spikingtac.robot.ur import URArm
from stand_ins.remote_arm import RemoteArm
from stand_ins.ur_controller import (
    DASHBOARD,
    EVERYTHING,
    POWER,
    PROTECTIVE,
    SCRIPT,
    STOPL,
    WATCHDOG,
    URController,
)
from stand_ins.waiting import SLACK_S, wait_until

pytestmark = pytest.mark.waits

FAR_MM = 800.0


@contextlib.contextmanager
def moving(controller: URController, **config: Any) -> Iterator[RemoteArm]:
    """Return a driver whose arm is moving at 40 mm/s."""
    with RemoteArm(controller.host, **config) as driver:
        driver.move_linear(driver.pose().position_mm + np.array([FAR_MM, 0.0, 0.0]), 40.0)
        wait_until(lambda: speed(controller) > 39.0)
        yield driver


@pytest.fixture
def arm(controller: URController) -> Iterator[RemoteArm]:
    with moving(controller) as driver:
        yield driver


@pytest.fixture
def patient_arm(controller: URController) -> Iterator[RemoteArm]:
    """Return a moving arm whose driver gives a busy machine time for each means."""
    with moving(controller, react_s=[1.0, 1.0, 1.0], watchdog_hz=0.2) as driver:
        yield driver


def speed(controller: URController) -> float:
    return float(np.linalg.norm(controller.twin.speed_mm_s()))


def test_a_stop_that_is_obeyed_needs_one_means(
    controller: URController, patient_arm: RemoteArm
) -> None:
    patient_arm.stop()
    patient_arm.confirm_stop()
    assert speed(controller) < 1.0
    assert "spikingtac" not in controller.scripts[-1]
    wait_until(lambda: patient_arm.state() is ArmState.IDLE)
    patient_arm.move_linear(patient_arm.pose().position_mm + np.array([1.0, 0.0, 0.0]), 20.0)


def test_letting_go_of_a_resting_arm_leaves_it_without_a_protective_stop(
    controller: URController,
) -> None:
    """The heartbeat ended a second before the control script, whose watchdog stopped the arm."""
    with RemoteArm(controller.host, watchdog_hz=2.0) as arm:
        arm.close()
        time.sleep(1.0)
    assert controller.twin.state() is ArmState.IDLE


@pytest.mark.parametrize(
    ("deaf_to", "script"),
    [
        ({STOPL}, "spikingtac_stop"),
        ({STOPL, SCRIPT, WATCHDOG}, "spikingtac_protect"),
        ({STOPL, SCRIPT, WATCHDOG, PROTECTIVE}, "spikingtac_protect"),
    ],
    ids=["a stop script", "a protective stop", "the dashboard"],
)
def test_a_stop_that_is_acknowledged_and_not_obeyed_is_followed_by_a_firmer_one(
    controller: URController, patient_arm: RemoteArm, deaf_to: set[str], script: str
) -> None:
    controller.deaf_to = frozenset(deaf_to)
    patient_arm.stop()
    patient_arm.confirm_stop()
    assert speed(controller) < 1.0
    assert script in controller.scripts[-1]
    wait_until(lambda: ("stop" in controller.dashboard_commands) == (SCRIPT in deaf_to))
    assert "power off" not in controller.dashboard_commands


def test_an_arm_that_does_not_stop_is_told_in_time_and_switched_off(
    controller: URController, arm: RemoteArm
) -> None:
    controller.deaf_to = EVERYTHING - {POWER}
    begun_s = time.monotonic()
    arm.stop()
    with pytest.raises(DeviceError, match=r"still moves at 40 mm/s after a stop, .*emergency stop"):
        arm.confirm_stop()
    assert time.monotonic() - begun_s < 0.2 + SLACK_S
    wait_until(lambda: "power off" in controller.dashboard_commands)
    wait_until(lambda: speed(controller) < 1.0)


def test_an_arm_that_nothing_is_heard_of_is_not_said_to_rest(
    controller: URController, arm: RemoteArm
) -> None:
    controller.stalled = True
    wait_until(lambda: arm.state() is ArmState.DISCONNECTED)
    arm.stop()
    with pytest.raises(DeviceError, match="nobody knows whether it rests"):
        arm.confirm_stop()
    assert "power off" not in controller.dashboard_commands  # it may well rest
    assert speed(controller) < 1.0


def test_no_call_waits_for_a_controller_that_falls_silent(
    controller: URController, arm: RemoteArm
) -> None:
    controller.half_open = True
    limits_s = {"pose": 0.1, "state": 0.1, "stop": 0.1, "confirm_stop": 0.2, "close": 10.0}
    for name, limit_s in limits_s.items():
        begun_s = time.monotonic()
        with contextlib.suppress(DeviceError):
            getattr(arm, name)()
        assert time.monotonic() - begun_s < limit_s + SLACK_S, name
    assert speed(controller) < 1.0  # by its own watchdog
    assert arm.end() == 0


def test_a_motion_that_is_not_answered_is_an_error_and_is_stopped(
    controller: URController, arm: RemoteArm
) -> None:
    arm.stop()
    arm.confirm_stop()
    wait_until(lambda: arm.state() is ArmState.IDLE)
    controller.swallowed = True  # reports go on, commands are lost
    begun_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"no answer within|refused the motion"):
        arm.move_linear(arm.pose().position_mm + np.array([FAR_MM, 0.0, 0.0]), 40.0)
    assert time.monotonic() - begun_s < 0.5 + 0.2 + SLACK_S
    arm.confirm_stop()
    assert speed(controller) < 1.0


def test_a_controller_that_accepts_and_says_nothing_is_refused_in_time() -> None:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController() as silent:
        silent.half_open = True
        begun_s = time.monotonic()
        with pytest.raises(DeviceError, match="no UR controller answers"):
            RemoteArm(silent.host, connect_limit_s=0.5)
        assert time.monotonic() - begun_s < 3.0 + 2 * SLACK_S  # the process starts meanwhile


@pytest.mark.parametrize("deaf_to", [frozenset(), frozenset({STOPL, SCRIPT, DASHBOARD})])
def test_a_process_that_ends_brakes(
    controller: URController, arm: RemoteArm, deaf_to: frozenset[str]
) -> None:
    controller.deaf_to = deaf_to
    assert arm.end() == 0
    wait_until(lambda: speed(controller) < 1.0)


@pytest.mark.parametrize(("e_series", "rate_hz"), [(False, 125.0), (True, 500.0)])
def test_both_series_are_driven_at_their_rate(e_series: bool, rate_hz: float) -> None:
    pytest.importorskip("rtde_control", reason="the extra [robot] is not installed")
    with URController(e_series) as controller, RemoteArm(controller.host) as arm:
        assert controller.asked_rates_hz == [rate_hz, rate_hz]
        assert "rtde_set_watchdog" in controller.scripts[0]
        target = arm.pose().position_mm + np.array([1.0, 0.0, 0.0])
        arm.move_linear(target, 20.0)
        wait_until(lambda: arm.state() is ArmState.IDLE)
        np.testing.assert_allclose(arm.pose().position_mm, target, atol=0.05)


def test_a_protective_stop_is_seen_and_refuses_motion(
    controller: URController, arm: RemoteArm
) -> None:
    controller.protective_stop()
    wait_until(lambda: arm.state() is ArmState.PROTECTIVE_STOP, 0.5 + SLACK_S)
    with pytest.raises(DeviceError, match="protective stop"):
        arm.move_linear(np.zeros(3), 10.0)


def test_a_lost_controller_is_reported_at_once_and_found_again(
    controller: URController, arm: RemoteArm
) -> None:
    controller.shut_down()
    wait_until(lambda: arm.state() is ArmState.DISCONNECTED, 0.1 + SLACK_S)
    start_s = time.monotonic()
    arm.stop()
    with pytest.raises(DeviceError, match=r"nothing is heard of the arm.* no script could be sent"):
        arm.confirm_stop()
    assert time.monotonic() - start_s < 0.2 + SLACK_S
    wait_until(lambda: controller.twin.state() is ArmState.PROTECTIVE_STOP)
    assert arm.end() == 0
    controller.start_again()
    controller.twin.recover()
    with RemoteArm(controller.host) as new:
        wait_until(lambda: new.state() is ArmState.IDLE)


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rtde_control", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[robot\]"):
        URArm("127.0.0.1")
