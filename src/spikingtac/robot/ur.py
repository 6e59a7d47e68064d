"""A real UR arm through ur_rtde (the extra ``[robot]``); see :class:`~spikingtac.robot.arm.Arm`.

Not a safety function. The driver adds to ur_rtde what an unattended loop needs: reading a pose
that is too old raises an error, a lost connection is reported at once, and the controller stops by
itself when this computer sends nothing (URScript's watchdog, action "stop").
"""

from __future__ import annotations

import atexit
import contextlib
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, DeviceError, MissingExtraError
from spikingtac.robot.arm import ArmState
from spikingtac.types import Pose

Vector = NDArray[np.float64]

RECEIVED = [
    "timestamp", "actual_TCP_pose", "actual_TCP_speed", "target_TCP_speed", "robot_status_bits",
    "safety_status_bits", "runtime_state",
]  # fmt: skip
"""What is asked of the controller: enough for the protocol, little enough for CB3 at 125 Hz."""
MM_PER_M = 1000.0
SCRIPT_PORT = 30002
PROGRAM_RUNNING = 0b10
"""Bit of the robot's status: a program runs."""
REST_MM_S = 0.01
"""Set-point speed below which the arm rests, mm/s; set points carry no noise."""


@dataclass(frozen=True, kw_only=True)
class URConfig:
    """How to talk to the arm, and how it moves.

    Attributes:
        acceleration_m_s2: Acceleration of ``movel``, m/s2 (URScript's default).
        deceleration_m_s2: Deceleration of a stop, m/s2 (contract.md: 8).
        speed_limit_mm_s: Fastest tool speed that is accepted, mm/s (UR3 manual, 1 m/s).
        patience_s: Age of the last report at which the stream counts as lost, s (ours: 12 cycles
            of CB3).
        start_patience_s: Longest wait for a commanded motion to begin, s.
        watchdog_hz: Least rate at which the controller must hear from this computer, Hz; it makes
            a protective stop otherwise. None leaves the controller without one.
    """

    acceleration_m_s2: float = 1.2
    deceleration_m_s2: float = 8.0
    speed_limit_mm_s: float = 1000.0
    patience_s: float = 0.1
    start_patience_s: float = 0.5
    watchdog_hz: float | None = 10.0


class URArm:
    """A UR arm on the network, at rest and in remote control.

    Args:
        host: Its address; ports 29999, 30002 to 30004 are used.
        config: How to talk to it.
        clock_s: A monotonic clock, s.

    Raises:
        MissingExtraError: ur_rtde is not installed.
        DeviceError: The controller does not answer, or refuses.
    """

    def __init__(
        self,
        host: str,
        config: URConfig | None = None,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._config = config or URConfig()
        self._clock_s = clock_s
        self._lock = threading.RLock()
        self._open()

    def pose(self) -> Pose:
        """Return the last reported pose; see :class:`~spikingtac.robot.arm.Arm`."""
        self._require_stream()
        values = np.array(self._receive.getActualTCPPose())
        return Pose(position_mm=values[:3] * MM_PER_M, rotation=rotation_matrix(values[3:]))

    def speed_mm_s(self) -> Vector:
        """Return the last reported velocity ``(3,)`` of the tool, mm/s."""
        self._require_stream()
        return np.array(self._receive.getActualTCPSpeed()[:3]) * MM_PER_M

    def move_linear(self, target_mm: Vector, speed_mm_s: float) -> None:
        """Start a straight motion; see :class:`~spikingtac.robot.arm.Arm`."""
        config = self._config
        target = np.asarray(target_mm, np.float64)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise ConfigError(f"the target is {target_mm!r}, it must be three finite numbers in mm")
        if not 0.0 < speed_mm_s <= config.speed_limit_mm_s:
            raise ConfigError(
                f"the speed is {speed_mm_s} mm/s, valid is above 0 up to {config.speed_limit_mm_s}"
            )
        state = self.state()
        if state is not ArmState.IDLE:
            raise DeviceError(
                f"the arm cannot start a motion: it is in state {state.value!r}; "
                "stop it, or clear its fault, and wait until it is idle"
            )
        rotation = self._receive.getActualTCPPose()[3:]
        goal = [*(target / MM_PER_M).tolist(), *rotation]
        speed, acceleration = speed_mm_s / MM_PER_M, config.acceleration_m_s2
        self._commanded_s, self._began = self._clock_s(), False
        if not self._call(lambda: self._control.moveL(goal, speed, acceleration, True)):
            self._began = True
            raise DeviceError("the controller refused the motion; look at its teach pendant")

    def stop(self) -> None:
        """Brake; see :class:`~spikingtac.robot.arm.Arm`.

        Where the control script does not answer, a stop script is sent on the script port instead,
        which ends the control script.
        """
        self._began = True
        if self._closed:
            raise DeviceError("the arm is not connected any more; make a new one")
        deceleration = self._config.deceleration_m_s2
        if not self._is_fresh() or not self._scripted():
            self._stop_by_script(deceleration)
            return
        self._call(lambda: self._control.stopL(deceleration, True))

    def state(self) -> ArmState:
        """Return what the arm does, as last reported."""
        if self._closed or not self._is_fresh():
            return ArmState.DISCONNECTED
        if self._receive.isProtectiveStopped() or self._receive.isEmergencyStopped():
            return ArmState.PROTECTIVE_STOP
        setpoint = np.array(self._receive.getTargetTCPSpeed()[:3]) * MM_PER_M
        if float(np.linalg.norm(setpoint)) > REST_MM_S:
            self._began = True
            return ArmState.MOVING
        waited_s = self._clock_s() - self._commanded_s
        pending = not self._began and waited_s < self._config.start_patience_s
        return ArmState.MOVING if pending else ArmState.IDLE

    def reconnect(self) -> None:
        """Close the connection and open it again, after a loss.

        Raises:
            DeviceError: The controller does not answer.
        """
        self._let_go()
        self._open()

    def close(self) -> None:
        """Stop and let go of the controller."""
        if not self._closed:
            with contextlib.suppress(DeviceError):
                self.stop()
            self._let_go()

    def _open(self) -> None:
        self._receive, self._control = _connect(self._host)
        self._stamp, self._stamp_seen_s = -1.0, self._clock_s()
        self._commanded_s = -np.inf
        self._began = True
        self._closed = False
        self._end_heartbeat = threading.Event()
        self._heartbeat = threading.Thread(target=self._beat, name="ur-heartbeat", daemon=True)
        if self._config.watchdog_hz is not None:
            self._call(lambda: self._control.setWatchdog(self._config.watchdog_hz))
            self._heartbeat.start()
        atexit.register(self.close)  # ur_rtde's threads crash an interpreter that ends before them

    def _let_go(self) -> None:
        self._closed = True
        atexit.unregister(self.close)
        self._end_heartbeat.set()
        if self._heartbeat.is_alive():
            self._heartbeat.join()
        for interface in (self._control, self._receive):
            with contextlib.suppress(Exception):  # whatever a broken native client raises
                interface.disconnect()

    def _beat(self) -> None:
        """Keep the controller's watchdog quiet, at three times the rate that it asks for."""
        period_s = 1.0 / (3.0 * (self._config.watchdog_hz or 1.0))
        while not self._end_heartbeat.wait(period_s):
            if self._is_fresh() and self._scripted():
                with contextlib.suppress(DeviceError):
                    self._call(self._control.kickWatchdog)

    def _is_fresh(self) -> bool:
        """Return whether the controller's own time advanced lately."""
        stamp, now_s = self._receive.getTimestamp(), self._clock_s()
        if stamp != self._stamp:
            self._stamp, self._stamp_seen_s = stamp, now_s
        return now_s - self._stamp_seen_s <= self._config.patience_s

    def _require_stream(self) -> None:
        if self._closed:
            raise DeviceError("the arm is not connected any more; make a new one")
        if not self._is_fresh():
            raise DeviceError(
                f"no report from the controller at {self._host} for more than "
                f"{self._config.patience_s} s; check the network, then reconnect"
            )

    def _scripted(self) -> bool:
        return bool(self._receive.getRobotStatus() & PROGRAM_RUNNING)

    def _call(self, command: Callable[[], Any]) -> Any:
        try:
            with self._lock:
                return command()
        except Exception as error:  # ur_rtde raises RuntimeError, logic_error and others
            raise DeviceError(f"the controller at {self._host} failed: {error}") from error

    def _stop_by_script(self, deceleration_m_s2: float) -> None:
        script = f"def spikingtac_stop():\n  stopl({deceleration_m_s2})\nend\n"
        try:
            timeout_s = self._config.patience_s
            with socket.create_connection((self._host, SCRIPT_PORT), timeout_s) as connection:
                connection.sendall(script.encode())
        except OSError as error:
            raise DeviceError(f"the stop could not be sent to {self._host}: {error}") from error


def _connect(host: str) -> tuple[Any, Any]:
    """Return ur_rtde's receive and control interfaces."""
    try:
        import rtde_control
        import rtde_receive
    except ImportError as error:
        raise MissingExtraError(
            "the UR driver needs ur_rtde; install it with: pip install 'spikingtac[robot]'"
        ) from error
    try:
        receive = rtde_receive.RTDEReceiveInterface(host, -1.0, RECEIVED)
        return receive, rtde_control.RTDEControlInterface(host)
    except Exception as error:  # ur_rtde raises RuntimeError, logic_error and others
        raise DeviceError(
            f"no UR controller answers at {host}: {error}; "
            "check address, power and that remote control is on"
        ) from error


def rotation_matrix(vector_rad: Vector) -> Vector:
    """Return the rotation ``(3, 3)`` of UR's rotation vector ``(3,)``, rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew
