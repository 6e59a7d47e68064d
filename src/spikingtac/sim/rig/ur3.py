"""A kinematic UR3 with the :class:`~spikingtac.robot.arm.Arm` protocol.

It models what determines the overshoot of the tool: delay of the network, cycle of the controller
with a random phase, lag of the servos, a stop with limited deceleration and jerk (planned with
ruckig), and a reported pose that is up to one cycle old and repeats only within the arm's
repeatability. At 180 mm/s a perfect sensor overshoots 6.2 mm on average, 7.6 mm at most.
"""

import math
import time
from typing import Any, NamedTuple

import numpy as np

from spikingtac.errors import DeviceError, MissingExtraError
from spikingtac.robot.arm import ArmState, checked_target
from spikingtac.types import FloatArray, Pose

DECELERATION_MM_S2 = 8000.0  # Deceleration of a stop, mm/s² (contract.md).
ACCELERATION_MM_S2 = 1200.0  # Acceleration of ``movel``, mm/s² (URScript's default, 1.2 m/s²).
STOP_S, POLL_S = 0.2, 0.002  # Longest wait for the end of a stop, and time between two looks, s.
SERVO_LAG_S = (0.004, 0.012)  # Range of the axes' lag behind their set points, s (contract.md).

# Standard deviation of one reading per axis, mm ("+-0.1 mm", 3.6 sigma).
REPEATABILITY_MM = 0.028


class Segment(NamedTuple):
    """One planned motion along a line. Before its start and after its end the arm stands still.

    Attributes:
        start_s: Controller time at which the motion begins, s.
        origin_mm: ``(3,)`` position at path coordinate zero, mm.
        direction: ``(3,)`` unit vector of the path.
        plan: Trajectory of the path coordinate, or None if the arm stands still.
    """

    start_s: float
    origin_mm: FloatArray
    direction: FloatArray = np.zeros(3)
    plan: Any = None

    @property
    def end_s(self) -> float:
        """Controller time at which the motion has ended, s."""
        return self.start_s + (self.plan.duration if self.plan else 0.0)

    def along(self, time_s: float) -> tuple[float, float, float]:
        """Return path coordinate, speed and acceleration at a time (mm, mm/s, mm/s2)."""
        if self.plan is None:
            return 0.0, 0.0, 0.0
        state = self.plan.at_time(min(max(time_s - self.start_s, 0.0), self.plan.duration))
        return state[0][0], state[1][0], state[2][0]

    def position_mm(self, time_s: float) -> FloatArray:
        """Return the position ``(3,)`` at a time, mm."""
        return self.origin_mm + self.direction * self.along(time_s)[0]


def plan(start_s: float, origin_mm: FloatArray, direction: FloatArray, **asked: float) -> Segment:
    """Plan a motion along a line with ruckig.

    Args:
        start_s: Controller time of the start, s.
        origin_mm: ``(3,)`` position at path coordinate zero, mm.
        direction: ``(3,)`` unit vector of the path.
        asked: Values of ruckig's ``InputParameter`` (mm, s); a stop without ``target_position``.

    Raises:
        DeviceError: No trajectory meets the limits.
        MissingExtraError: ruckig is not installed.
    """
    try:
        import ruckig
    except ImportError as error:
        raise MissingExtraError(
            "the twin's arm needs ruckig, which has no ready package for this machine; install a "
            "C++ compiler, then: pip install 'spikingtac[arm]'"
        ) from error
    request, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    if "target_position" not in asked:
        request.control_interface = ruckig.ControlInterface.Velocity
    for name, value in asked.items():
        setattr(request, name, [value])
    result = ruckig.Ruckig(1).calculate(request, found)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise DeviceError(f"no trajectory fits the limits: ruckig says {result.name}")
    return Segment(start_s, origin_mm, direction, found)


class UR3Twin:
    """The simulated arm (twin.md, section 4). Its time advances only through :meth:`advance_to`.

    A copy made with :func:`copy.copy` continues independently from the present state.

    Args:
        start_mm: ``(3,)`` position at the start, mm.
        rng: Source of phase, lag and repeatability.
        repeatability_mm: Standard deviation of one reading per axis, mm.
    """

    CYCLE_S = 0.008  # Period of the controller, s (125 Hz for CB3).
    NETWORK_S = 0.003  # Delay from the computer to the controller, s.
    JERK_MM_S3 = 500_000.0  # Jerk limit of every motion, mm/s³.

    def __init__(
        self,
        start_mm: FloatArray,
        rng: np.random.Generator,
        repeatability_mm: float = REPEATABILITY_MM,
    ) -> None:
        self._rng, self._repeatability_mm = rng, repeatability_mm
        self._now_us = 0
        self._phase_s = rng.uniform(0.0, self.CYCLE_S)
        self._draw_motion()
        self._segments = [Segment(-1.0, np.array(start_mm, np.float64))]
        self._fault: ArmState | None = None

    def _draw_motion(self) -> None:
        """Draw the lag and the error of the readings of one motion."""
        self._lag_s = self._rng.uniform(*SERVO_LAG_S)
        self._pose_error_mm = self._rng.normal(0.0, self._repeatability_mm, 3)

    def advance_to(self, t_us: int) -> None:
        """Advance the time to ``t_us``, which must not be before the present time."""
        if t_us < self._now_us:
            raise ValueError(f"the twin's clock stands at {self._now_us} us, not before {t_us} us")
        self._now_us = t_us

    def _time_us(self) -> int:
        return self._now_us

    def position_at_mm(self, t_us: float) -> FloatArray:
        """Return the true position ``(3,)`` at ``t_us``, mm; in the future, the planned one."""
        setpoint_s = t_us * 1e-6 - self._lag_s
        return self._segment(setpoint_s).position_mm(setpoint_s)

    def true_position_mm(self) -> FloatArray:
        """Return the true position ``(3,)`` now, mm."""
        return self.position_at_mm(self._time_us())

    def pose(self) -> Pose:
        """Return the pose of the last controller cycle, with the error of this reading.

        The error is drawn once per motion, so that reading twice gains nothing.
        """
        self._require_connection()
        return Pose(position_mm=self.position_at_mm(self._last_cycle_us()) + self._pose_error_mm)

    def speed_mm_s(self) -> FloatArray:
        """Return the tool's velocity ``(3,)`` at the last controller cycle, mm/s."""
        self._require_connection()
        setpoint_s = self._last_cycle_us() * 1e-6 - self._lag_s
        segment = self._segment(setpoint_s)
        return segment.direction * segment.along(setpoint_s)[1]

    def move_linear(self, target_mm: FloatArray, speed_mm_s: float) -> None:
        """Start a straight motion; see :class:`~spikingtac.robot.arm.Arm`."""
        target = checked_target(target_mm, speed_mm_s, self.state())
        self._draw_motion()
        start_s = self._command_time_s()
        here = self._segments[-1].position_mm(start_s)
        length = float(np.linalg.norm(target - here))
        begun = Segment(start_s, here)
        if length > 0.0:
            limits = {"max_acceleration": ACCELERATION_MM_S2, "max_jerk": self.JERK_MM_S3}
            asked = {"target_position": length, "max_velocity": speed_mm_s, **limits}
            begun = plan(start_s, here, (target - here) / length, **asked)
        self._segments = [self._segments[-1], begun]

    def stop(self) -> None:
        """Brake from the next controller cycle; see :class:`~spikingtac.robot.arm.Arm`."""
        self._require_connection()
        self._brake(self._command_time_s())

    def confirm_stop(self) -> None:
        """Return at once: the twin always stops, and its time advances elsewhere."""

    def state(self) -> ArmState:
        """Return the state of the arm at the last controller cycle."""
        if self._fault is not None:
            return self._fault
        at_rest = self._last_cycle_us() * 1e-6 >= self._segments[-1].end_s + self._lag_s
        return ArmState.IDLE if at_rest else ArmState.MOVING

    def close(self) -> None:
        """Stop and disconnect."""
        if self._fault is not ArmState.DISCONNECTED:
            self.stop()
            self._fault = ArmState.DISCONNECTED

    def relocate(self, position_mm: FloatArray) -> None:
        """Move to another place at once, instead of travel that need not be simulated.

        Raises:
            DeviceError: The arm is not at rest.
        """
        if self.state() is not ArmState.IDLE:
            raise DeviceError(f"only an arm at rest can be placed, it is {self.state().value!r}")
        self._segments = [Segment(-1.0, np.array(position_mm, np.float64))]

    def protective_stop(self) -> None:
        """Stop as the controller does at a force limit. :meth:`recover` clears the state."""
        self._brake(self._command_time_s() - self.NETWORK_S)
        self._fault = ArmState.PROTECTIVE_STOP

    def recover(self) -> None:
        """Clear a protective stop."""
        if self._fault is ArmState.PROTECTIVE_STOP:
            self._fault = None

    def _brake(self, start_s: float) -> None:
        last = self._segments[-1]
        if start_s < last.start_s:
            self._segments = [*self._segments[:-1], Segment(start_s, last.origin_mm)]
        elif start_s < last.end_s:
            distance, speed, acceleration = last.along(start_s)
            stop = Segment(start_s, last.position_mm(start_s), last.direction)
            if speed != 0.0 or acceleration != 0.0:
                braking = float(np.clip(acceleration, -DECELERATION_MM_S2, DECELERATION_MM_S2))
                now = {"current_position": distance, "current_velocity": speed}
                limits = {"max_acceleration": DECELERATION_MM_S2, "max_jerk": self.JERK_MM_S3}
                asked = {**now, "current_acceleration": braking, "target_velocity": 0.0, **limits}
                stop = plan(start_s, last.origin_mm, last.direction, **asked)
            if stop.end_s < last.end_s:
                self._segments = [*self._segments, stop]

    def _segment(self, setpoint_s: float) -> Segment:
        begun = (one for one in reversed(self._segments) if setpoint_s >= one.start_s)
        return next(begun, self._segments[0])

    def _command_time_s(self) -> float:
        """Return the time of the first controller cycle that can execute a command sent now, s."""
        arrival_s = self._time_us() * 1e-6 + self.NETWORK_S
        cycles = math.ceil((arrival_s - self._phase_s) / self.CYCLE_S)
        return self._phase_s + cycles * self.CYCLE_S

    def _last_cycle_us(self) -> float:
        cycles = math.floor((self._time_us() * 1e-6 - self._phase_s) / self.CYCLE_S)
        return (self._phase_s + cycles * self.CYCLE_S) * 1e6

    def _require_connection(self) -> None:
        if self._fault is ArmState.DISCONNECTED:
            raise DeviceError("the arm is not connected any more; make a new one")


class RealTimeArm(UR3Twin):
    """A simulated UR3 that starts at the origin; its time is the host's. ``twin:`` opens it."""

    def __init__(self) -> None:
        super().__init__(np.zeros(3), np.random.default_rng(0))
        self._zero_s = time.monotonic()

    def confirm_stop(self) -> None:
        """Wait until the arm rests; see :class:`~spikingtac.robot.arm.Arm`."""
        until_s = time.monotonic() + STOP_S
        while self.state() is ArmState.MOVING:
            if time.monotonic() > until_s:
                raise DeviceError("the simulated arm still moves; nothing told it to stop")
            time.sleep(POLL_S)

    def _time_us(self) -> int:
        return round(1e6 * (time.monotonic() - self._zero_s))
