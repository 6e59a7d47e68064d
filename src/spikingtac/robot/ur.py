"""A real UR arm through ur_rtde (the extra ``[robot]``); see :class:`~spikingtac.robot.arm.Arm`.

Not a safety function. The driver adds to ur_rtde what an unattended loop needs: reading a pose
that is too old raises an error, a lost connection is reported at once, the controller stops by
itself when this computer sends nothing (URScript's watchdog, action "stop"), a stop is verified by
the arm's reported speed, and no call waits without limit.
"""

import atexit
import contextlib
import importlib
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.robot.arm import Arm, ArmState, checked_target
from spikingtac.robot.ur_client import DISCONNECT_S, BoundedCalls, connect, disconnect
from spikingtac.robot.ur_stop import (
    CALL_LIMIT_S,
    DECELERATION_M_S2,
    Means,
    Report,
    VerifiedStop,
    dashboard,
    send_script,
)
from spikingtac.types import FloatArray, Pose

MM_PER_M = 1000.0
PROGRAM_RUNNING = 0b10  # Bit of the robot's status: a program runs.
ACCELERATION_M_S2 = 1.2  # Acceleration of ``movel``, m/s2 (URScript's default).
START_PATIENCE_S = 0.5  # Longest wait for a commanded motion to begin, s.

REST_MM_S = 0.01  # Set-point speed below which the arm rests, mm/s; set points carry no noise.

# Programs that stop the arm, and that make the controller stop it as on a limit of force.
STOP = f"def spikingtac_stop():\n  stopl({DECELERATION_M_S2})\nend\n"
PROTECT = "def spikingtac_protect():\n  protective_stop()\nend\n"

# Module of the simulated arm, which is built on this package's protocol of an arm.
TWIN_ARM = "spikingtac.sim.rig.ur3"

PATIENCE_S = 0.1  # Age of the last report at which the stream counts as lost, s (12 cycles of CB3).

# Least rate at which the controller must hear from this computer, Hz; else it makes a protective
# stop (URScript's watchdog).
WATCHDOG_HZ = 10.0
CONNECT_LIMIT_S = 2.0  # Longest wait for each port's first answer, s.

# Time that each means has until the speed must fall, s. The first one passes through the control
# script, 8 ms; then a cycle of 8 ms, a servo lag of up to 12 ms, the jerk limit's 16 ms and the
# report's 8 ms. Together they leave 0.06 s of the 0.2 s within which a failure is to be reported.
REACT_S = (0.055, 0.045, 0.035)


class URArm:
    """A UR arm on the network, at rest and in remote control.

    Args:
        host: Its address; ports 29999, 30002 to 30004 are used.

    Raises:
        MissingExtraError: ur_rtde is not installed.
        DeviceError: The controller does not answer, or refuses.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self._receive, self._control = connect(host, CONNECT_LIMIT_S)
        self._calls = BoundedCalls(f"the controller at {host}")
        self._lost, self._closed, self._began = False, False, True
        self._stamp, self._stamp_seen_s, self._commanded_s = -1.0, time.monotonic(), -np.inf
        means = (
            Means("a stop", self._stop_gently, REACT_S[0]),
            Means("a stop script", self._stop_by_own_script, REACT_S[1]),
            Means("a protective stop", self._stop_protectively, REACT_S[2]),
        )
        power_off = Means("power off", lambda: dashboard(host, "power off"))
        self._stopping = VerifiedStop(means, self._report, power_off)
        self._end_heartbeat = threading.Event()
        self._heartbeat = threading.Thread(target=self._beat, name="ur-heartbeat", daemon=True)
        self._call(lambda: self._control.setWatchdog(WATCHDOG_HZ))
        self._heartbeat.start()
        atexit.register(self._close_at_exit)  # ur_rtde's threads crash an interpreter that ends

    def pose(self) -> Pose:
        """Return the last reported pose; see :class:`~spikingtac.robot.arm.Arm`."""
        self._require_stream()
        values = np.array(self._receive.getActualTCPPose())
        return Pose(
            position_mm=values[:3] * MM_PER_M, rotation=Rotation.from_rotvec(values[3:]).as_matrix()
        )

    def speed_mm_s(self) -> FloatArray:
        """Return the last reported velocity ``(3,)`` of the tool, mm/s."""
        self._require_stream()
        return np.array(self._receive.getActualTCPSpeed()[:3]) * MM_PER_M

    def move_linear(self, target_mm: FloatArray, speed_mm_s: float) -> None:
        """Start a straight motion; see :class:`~spikingtac.robot.arm.Arm`."""
        target = checked_target(target_mm, speed_mm_s, self.state())
        goal = [*(target / MM_PER_M).tolist(), *self._receive.getActualTCPPose()[3:]]
        motion = goal, speed_mm_s / MM_PER_M, ACCELERATION_M_S2, True
        self._commanded_s, self._began = time.monotonic(), False
        try:
            if not self._call(lambda: self._control.moveL(*motion), self._stopping.begin):
                raise DeviceError("the controller refused the motion; look at its teach pendant")
        except DeviceError:
            self.stop()  # it may begin yet: ur_rtde does not say whether the command was sent
            raise

    def stop(self) -> None:
        """Brake; see :class:`~spikingtac.robot.arm.Arm`.

        The arm is watched from here on, and stopped more firmly where its speed does not fall:
        ``stopl`` in the control script; a program of its own on the script port; a protective stop;
        and at last its power is switched off, so that its brakes hold it.
        """
        self._began = True
        if self._closed:
            raise DeviceError("the arm is not connected any more; make a new one")
        self._stopping.begin()

    def confirm_stop(self) -> None:
        """Wait until the arm rests; see :class:`~spikingtac.robot.arm.Arm`."""
        self._stopping.confirm()

    def state(self) -> ArmState:
        """Return what the arm does, as last reported."""
        if self._closed or self._is_lost() or not self._is_fresh():
            return ArmState.DISCONNECTED
        if self._receive.isProtectiveStopped() or self._receive.isEmergencyStopped():
            return ArmState.PROTECTIVE_STOP
        if self._stopping.running:
            return ArmState.MOVING
        setpoint = np.array(self._receive.getTargetTCPSpeed()[:3]) * MM_PER_M
        if float(np.linalg.norm(setpoint)) > REST_MM_S:
            self._began = True
            return ArmState.MOVING
        pending = not self._began and time.monotonic() - self._commanded_s < START_PATIENCE_S
        return ArmState.MOVING if pending else ArmState.IDLE

    def close(self) -> None:
        """Stop, wait until the arm rests, and let go of the controller.

        Raises:
            DeviceError: It moves on, or nothing says that it rests.
        """
        if self._closed:
            return
        try:
            self.stop()
            self.confirm_stop()
            if self._is_fresh() and self._scripted():  # its watchdog outlives the heartbeat
                self._call(self._control.stopScript)
        finally:
            self._closed = True
            atexit.unregister(self._close_at_exit)
            self._end_heartbeat.set()
            self._heartbeat.join(CALL_LIMIT_S)
            # An interpreter that ends while a native call returns to it is aborted: it is waited
            # for.
            hangs = not self._calls.end(DISCONNECT_S)
            for interface in (self._control, self._receive):
                disconnect(interface, hangs)

    def _close_at_exit(self) -> None:
        with contextlib.suppress(DeviceError):  # nobody is left who could be told
            self.close()

    def _beat(self) -> None:
        """Keep the controller's watchdog quiet, at three times the rate that it asks for."""
        period_s = 1.0 / (3.0 * WATCHDOG_HZ)
        while not self._end_heartbeat.wait(period_s):
            if self._is_fresh() and self._scripted() and not self._is_lost():
                with contextlib.suppress(DeviceError):
                    self._call(self._control.kickWatchdog)

    def _stop_gently(self) -> None:
        """Give the control script a stop, or send a program where there is no script."""
        if self._is_lost() or not (self._is_fresh() and self._scripted()):
            send_script(self._host, STOP)
        else:
            self._call(lambda: self._control.stopL(DECELERATION_M_S2, True))

    def _stop_by_own_script(self) -> None:
        """Send a program, which ends the one that runs; the controller's watchdog stops, too."""
        self._end_heartbeat.set()
        send_script(self._host, STOP)

    def _stop_protectively(self) -> None:
        """Make a protective stop; the dashboard, which has no command for one, ends the program."""
        send_script(self._host, PROTECT)
        dashboard(self._host, "stop")

    def _report(self) -> Report:
        """Return the last report, for the stop."""
        self._is_fresh()
        speed_mm_s = np.linalg.norm(self._receive.getActualTCPSpeed()[:3]) * MM_PER_M
        return Report(self._stamp_seen_s, float(speed_mm_s))

    def _is_lost(self) -> bool:
        """Return whether a command hung; what a client does after that is not known."""
        self._lost |= self._calls.running_s() > CALL_LIMIT_S
        return self._lost

    def _is_fresh(self) -> bool:
        """Return whether the controller's own time advanced lately."""
        # The clock first: a thread that is held up in between takes no report for old.
        now_s, stamp = time.monotonic(), self._receive.getTimestamp()
        if stamp != self._stamp:
            self._stamp, self._stamp_seen_s = stamp, now_s
        return now_s - self._stamp_seen_s <= PATIENCE_S

    def _require_stream(self) -> None:
        if self._closed:
            raise DeviceError("the arm is not connected any more; make a new one")
        if not self._is_fresh():
            raise DeviceError(
                f"no report from the controller at {self._host} for more than "
                f"{PATIENCE_S} s; check the network, then make a new one"
            )

    def _scripted(self) -> bool:
        return bool(self._receive.getRobotStatus() & PROGRAM_RUNNING)

    def _call(self, command: Callable[[], Any], late: Callable[[], None] = lambda: None) -> Any:
        """Give the control interface a command; see :meth:`BoundedCalls.call`."""
        if self._is_lost():
            raise DeviceError(
                f"the controller at {self._host} left a command unanswered; make a new one"
            )
        return self._calls.call(command, CALL_LIMIT_S, late)


def open_arm(address: str) -> Arm:
    """Return the arm at an address: a simulated one at ``twin:``, else a UR arm on the network.

    Raises:
        ConfigError: The address is empty, or ``twin:`` is followed by something.
        MissingExtraError: The arm's library is not installed.
        DeviceError: The controller does not answer, or refuses.
    """
    kind, colon, rest = str(address).partition(":")
    if not address or (kind == "twin" and (rest or not colon)):
        raise ConfigError(f"no arm {address!r} (valid: twin:, or the address of a UR arm)")
    if kind == "twin":  # loaded by name: the twin is built on this room
        return importlib.import_module(TWIN_ARM).RealTimeArm()
    return URArm(address)
