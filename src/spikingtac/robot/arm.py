"""The protocol of an arm: the digital twin and the real UR have the same methods.

Lengths are mm, speeds mm/s, in the robot's base frame; positions are those of the tool centre
point, which stands at the tip of the probe at rest.
"""

import enum
from typing import Protocol, runtime_checkable

import numpy as np

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.types import FloatArray, Pose

SPEED_LIMIT_MM_S = 1000.0  # Largest tool speed that is accepted, mm/s (UR3 manual, 1 m/s).


class ArmState(enum.Enum):
    """What the arm can do now."""

    IDLE = "idle"
    MOVING = "moving"
    PROTECTIVE_STOP = "protective stop"
    DISCONNECTED = "disconnected"


@runtime_checkable
class Arm(Protocol):
    """A position-controlled arm. No call blocks for longer than one message needs."""

    def pose(self) -> Pose:
        """Return the last pose that the controller reported (it may be a control cycle old).

        Raises:
            DeviceError: Nothing was received within the driver's patience.
        """
        ...

    def speed_mm_s(self) -> FloatArray:
        """Return the velocity ``(3,)`` of the tool as last reported, mm/s."""
        ...

    def move_linear(self, target_mm: FloatArray, speed_mm_s: float) -> None:
        """Start to move along a straight line, keeping the rotation, and return at once.

        Raises:
            DeviceError: The arm moves already, stands in a protective stop, or is not connected.
            ConfigError: The target is not three finite numbers, or the speed is out of range.
        """
        ...

    def stop(self) -> None:
        """Brake along the path and return at once; harmless when the arm is at rest.

        Raises:
            DeviceError: The arm is not connected any more.
        """
        ...

    def confirm_stop(self) -> None:
        """Wait for the outcome of the last stop, within the driver's limits (UR: 0.2 s).

        Raises:
            DeviceError: The arm moves on, or nothing says that it rests.
        """
        ...

    def state(self) -> ArmState:
        """Return what the arm does; MOVING from the return of ``move_linear`` until at rest."""
        ...

    def close(self) -> None:
        """Stop, confirm it, and let go of the controller; harmless when repeated."""
        ...


def checked_target(target_mm: FloatArray, speed_mm_s: float, state: ArmState) -> FloatArray:
    """Return the target ``(3,)`` of a motion that begins in a state, mm.

    Raises:
        ConfigError: The target is not three finite numbers, or the speed is out of range.
        DeviceError: The arm is not idle.
    """
    target = np.asarray(target_mm, np.float64)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise ConfigError(f"the target is {target_mm!r}, it must be three finite numbers in mm")
    if not 0.0 < speed_mm_s <= SPEED_LIMIT_MM_S:
        raise ConfigError(
            f"the speed is {speed_mm_s} mm/s, valid is above 0 up to {SPEED_LIMIT_MM_S}"
        )
    if state is not ArmState.IDLE:
        raise DeviceError(
            f"the arm cannot start a motion: it is in state {state.value!r}; "
            "stop it, or clear its fault, and wait until it is idle"
        )
    return target
