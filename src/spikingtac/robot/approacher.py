"""Move until contact, then stop; one loop for the twin and the hardware (Section V-B).

The loop takes one window after another. On the twin this lets simulated time pass; on hardware it
waits for the camera.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from spikingtac.contact.detector import WINDOW_US, ContactDetector, Window
from spikingtac.errors import DeviceError
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.watchdog import Watchdog
from spikingtac.types import US_PER_S, Contact, FloatArray

# Largest share by which the reported speed differs from the commanded one at constant speed: while
# the arm accelerates, the probe's own inertia moves the markers.
CRUISE_TOLERANCE = 0.02

# An arm that does not rest after so many times the time of its way, and these seconds, is faulty.
PATIENCE, PATIENCE_S = 2.0, 1.0


@dataclass(frozen=True, kw_only=True)
class ApproachConfig:
    """How to approach.

    Attributes:
        speed_mm_s: Speed of the tool, mm/s.
        settle_windows: Windows to wait at constant speed before the detector is used, until the
            probe's vibration has decayed.
    """

    speed_mm_s: float = 80.0
    settle_windows: int = 150


@dataclass(frozen=True, slots=True)
class Approach:
    """What an approach found.

    Attributes:
        contact: The decision, or None where the target was reached without one.
        collision_mm: ``(3,)`` X_collision as the controller reported it at the decision, mm.
        stop_mm: ``(3,)`` X_stop, as reported at rest, mm.
    """

    contact: Contact | None
    collision_mm: FloatArray | None
    stop_mm: FloatArray


def approach(
    arm: Arm,
    windows: Iterable[Window],
    detector: ContactDetector | None,
    target_mm: FloatArray,
    config: ApproachConfig | None = None,
    watchdog: Watchdog | None = None,
) -> Approach:
    """Move an arm towards a target, stop it at contact, and return once it is at rest.

    Args:
        arm: The arm, at rest.
        windows: Windows of 1 ms of its sensor or sensors.
        detector: Is given each window while the arm moves at constant speed; None never decides.
            See :func:`spikingtac.make_detector`.
        target_mm: ``(3,)`` target of the tool in the robot's base frame, mm.
        config: How to approach.
        watchdog: Checked with every window; a trip ends the approach with a DeviceError.

    Raises:
        ConfigError: The target is not three numbers, or the speed is out of range.
        DeviceError: The watchdog tripped, the stream ended, the arm stopped by itself, or it
            did not come to rest; the arm was commanded to stop first.
    """
    settings, stream, start_mm = config or ApproachConfig(), iter(windows), arm.pose().position_mm
    contact, read_mm, cruising = None, None, 0
    try:
        arm.move_linear(target_mm, settings.speed_mm_s)  # refuses what is no target, or no speed
        way_mm = np.asarray(target_mm, np.float64) - start_mm
        direction = way_mm / max(float(np.linalg.norm(way_mm)), np.finfo(float).tiny)
        patience_s = PATIENCE * float(way_mm @ direction) / settings.speed_mm_s + PATIENCE_S
        for _ in range(math.ceil(patience_s * US_PER_S / WINDOW_US)):
            window = next_window(stream, watchdog)
            if contact is None and detector is not None and cruising >= settings.settle_windows:
                contact = detector.update(window)
                if contact is not None:
                    arm.stop()
                    read_mm = arm.pose().position_mm
            if contact is None:
                pace = float(arm.speed_mm_s() @ direction) / settings.speed_mm_s
                cruising = cruising + 1 if abs(pace - 1.0) <= CRUISE_TOLERANCE else 0
            state = arm.state()
            if state is ArmState.IDLE:
                break
            if state is not ArmState.MOVING:
                raise DeviceError(f"the arm stopped by itself: {state.value}")
        else:
            raise DeviceError(f"no rest within {patience_s:.1f} s; check the arm, speed and target")
        if contact is not None:
            arm.confirm_stop()
    except BaseException as fault:
        _stop_after(arm, fault)
        raise
    return Approach(contact, read_mm, arm.pose().position_mm)


def next_window(stream: Iterator[Window], watchdog: Watchdog | None) -> Window:
    """Return the next window.

    Raises:
        DeviceError: There is none, or the watchdog has tripped.
    """
    window = next(stream, None)
    if window is None:
        raise DeviceError("the sensor's stream ended during an approach; the arm was stopped")
    if watchdog is not None:
        watchdog.require_ok()
    return window


def _stop_after(arm: Arm, fault: BaseException) -> None:
    """Stop the arm after a fault, which is the one to report unless the arm moves on.

    Raises:
        DeviceError: The arm is not known to rest.
    """
    try:
        arm.stop()
        arm.confirm_stop()
    except DeviceError as failure:
        if arm.state() is not ArmState.DISCONNECTED:
            raise DeviceError(f"{failure} (the first fault: {fault})") from fault
