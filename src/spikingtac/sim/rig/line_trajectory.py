"""Jerk-limited motion of the arm along a line, computed with ruckig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.errors import DeviceError, MissingExtraError

if TYPE_CHECKING:
    from ruckig import InputParameter, Trajectory


@dataclass(frozen=True)
class Segment:
    """One planned motion along a line. Before its start and after its end the arm stands still.

    Attributes:
        start_s: Controller time at which the motion begins, s.
        origin_mm: ``(3,)`` position at path coordinate zero, mm.
        direction: ``(3,)`` unit vector of the path.
        plan: Trajectory of the path coordinate, or None if the arm stands still.
    """

    start_s: float
    origin_mm: FloatArray
    direction: FloatArray
    plan: Trajectory | None = None

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

    def velocity_mm_s(self, time_s: float) -> FloatArray:
        """Return the velocity ``(3,)`` at a time, mm/s."""
        return self.direction * self.along(time_s)[1]


def plan_move(
    start_s: float, origin_mm: FloatArray, target_mm: FloatArray, limits: tuple[float, float, float]
) -> Segment:
    """Plan a motion from rest at ``origin_mm`` to rest at ``target_mm``.

    Args:
        start_s: Controller time of the start, s.
        origin_mm: ``(3,)`` start, mm.
        target_mm: ``(3,)`` target, mm.
        limits: Speed (mm/s), acceleration (mm/s²) and jerk (mm/s³).

    Raises:
        DeviceError: No trajectory meets the limits.
    """
    path = target_mm - origin_mm
    length = float(np.linalg.norm(path))
    if length == 0.0:
        return Segment(start_s, origin_mm, np.zeros(3))
    request = _ruckig().InputParameter(1)
    request.target_position = [length]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([x] for x in limits)
    return Segment(start_s, origin_mm, path / length, _solve(request))


def plan_stop(start_s: float, moving: Segment, deceleration_mm_s2: float, jerk: float) -> Segment:
    """Plan a stop along the path of ``moving``, from its state at ``start_s``.

    Args:
        start_s: Controller time of the start, s.
        moving: Present motion.
        deceleration_mm_s2: Largest deceleration, mm/s².
        jerk: Largest jerk, mm/s³.

    Raises:
        DeviceError: No trajectory meets the limits.
    """
    distance, speed, acceleration = moving.along(start_s)
    if speed == 0.0 and acceleration == 0.0:
        return Segment(start_s, moving.position_mm(start_s), moving.direction)
    request = _ruckig().InputParameter(1)
    request.control_interface = _ruckig().ControlInterface.Velocity
    request.current_position = [distance]
    request.current_velocity = [speed]
    request.current_acceleration = [min(max(acceleration, -deceleration_mm_s2), deceleration_mm_s2)]
    request.target_velocity = [0.0]
    request.max_acceleration = [deceleration_mm_s2]
    request.max_jerk = [jerk]
    return Segment(start_s, moving.origin_mm, moving.direction, _solve(request))


def _solve(request: InputParameter) -> Trajectory:
    ruckig = _ruckig()
    plan = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(request, plan)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise DeviceError(f"no trajectory fits the limits: ruckig says {result.name}")
    return plan


def _ruckig() -> Any:
    """Return the library; it comes with the package where it can be had without a compiler."""
    try:
        import ruckig
    except ImportError as error:
        raise MissingExtraError(
            "the twin's arm needs ruckig, which has no ready package for this machine; install a "
            "C++ compiler, then: pip install 'spikingtac[arm]'"
        ) from error
    return ruckig
