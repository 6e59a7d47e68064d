"""Move until contact, then stop; one loop for the twin and the hardware (Section V-B).

The loop takes one window after another. On the twin this lets simulated time pass; on hardware it
waits for the camera.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from spikingtac.errors import DeviceError
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.watchdog import Watchdog
from spikingtac.types import Contact, FloatArray

W = TypeVar("W")

# Largest share by which the reported speed differs from the commanded one at constant speed: while
# the arm accelerates, the probe's own inertia moves the markers.
CRUISE_TOLERANCE = 0.02


class Detector(Protocol):
    """Decides on contact; every detector of :mod:`spikingtac.contact` is one."""

    def update(self, window: Any, /) -> Contact | None:
        """Take the next window and return a contact, once it is found."""
        ...


@dataclass(frozen=True, kw_only=True)
class ApproachConfig:
    """How to approach.

    Attributes:
        speed_mm_s: Speed of the tool, mm/s.
        settle_windows: Windows to wait at constant speed before the detector is used, until the
            probe's vibration has decayed.
        patience_windows: Number of windows within which the arm must have come to rest.
    """

    speed_mm_s: float = 80.0
    settle_windows: int = 150
    patience_windows: int = 60_000


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


class Approacher(Generic[W]):
    """Moves one arm until one detector finds contact.

    Args:
        arm: The arm, at rest.
        windows: Regular windows of its sensor or sensors; this object alone takes them.
        detector: Is given each window while the arm moves at constant speed; None never decides.
        config: How to approach.
        watchdog: Checked with every window; a trip ends the approach with a DeviceError.
    """

    def __init__(
        self,
        arm: Arm,
        windows: Iterable[W],
        detector: Detector | None,
        config: ApproachConfig,
        watchdog: Watchdog | None = None,
    ) -> None:
        self._arm, self._windows, self._detector = arm, iter(windows), detector
        self._config, self._watchdog = config, watchdog

    def approach(self, target_mm: FloatArray) -> Approach:
        """Move towards a target, stop at contact, and return once the arm is at rest.

        Raises:
            DeviceError: The watchdog tripped, the stream ended, the arm stopped by itself, or it
                did not come to rest; the arm was commanded to stop first.
        """
        way = np.asarray(target_mm, np.float64) - self._arm.pose().position_mm
        direction = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)
        try:
            self._arm.move_linear(target_mm, self._config.speed_mm_s)
            contact = self._listen(direction)
            read = self._arm.pose().position_mm if contact else None
            self._wait()
            if contact is not None:
                self._arm.confirm_stop()
        except BaseException as fault:
            _stop_after(self._arm, fault)
            raise
        return Approach(contact, read, self._arm.pose().position_mm)

    def wait(self, windows: int) -> None:
        """Let time pass with the arm at rest; the detector is not used.

        Raises:
            DeviceError: As :meth:`approach`.
        """
        for _ in range(windows):
            self._pull()

    def _listen(self, direction: FloatArray) -> Contact | None:
        """Return the contact, with the stop already sent, or None at the target."""
        cruising = 0
        for _ in range(self._config.patience_windows):
            window = self._pull()
            if self._detector is not None and cruising >= self._config.settle_windows:
                contact = self._detector.update(window)
                if contact is not None:
                    self._arm.stop()
                    return contact
            speed = float(self._arm.speed_mm_s() @ direction)
            steady = abs(speed / self._config.speed_mm_s - 1.0) <= CRUISE_TOLERANCE
            cruising = cruising + 1 if steady else 0
            if self._require_health() is not ArmState.MOVING:
                return None
        raise DeviceError(
            f"no contact and no target within {self._config.patience_windows} windows; "
            "raise patience_windows, or check speed and target"
        )

    def _wait(self) -> None:
        """Let windows pass until the arm is at rest."""
        for _ in range(self._config.patience_windows):
            if self._require_health() is not ArmState.MOVING:
                return
            self._pull()
        raise DeviceError("the arm did not come to rest; check it before anything else")

    def _pull(self) -> W:
        window = next(self._windows, None)
        if window is None:
            raise DeviceError("the sensor's stream ended during an approach; the arm was stopped")
        if self._watchdog is not None:
            self._watchdog.require_ok()
        return window

    def _require_health(self) -> ArmState:
        state = self._arm.state()
        if state in (ArmState.PROTECTIVE_STOP, ArmState.DISCONNECTED):
            raise DeviceError(f"the arm stopped by itself: {state.value}")
        return state


def approach(
    arm: Arm,
    windows: Iterable[W],
    detector: Detector,
    target_mm: FloatArray,
    config: ApproachConfig | None = None,
    watchdog: Watchdog | None = None,
) -> Approach:
    """Move an arm towards a target, stop it at contact, and return once it is at rest.

    Args:
        arm: The arm, at rest.
        windows: Regular windows of its sensor or sensors.
        detector: Decides on contact; see :func:`spikingtac.make_detector`.
        target_mm: ``(3,)`` target of the tool in the robot's base frame, mm.
        config: How to approach.
        watchdog: Checked with every window; a trip ends the approach with a DeviceError.

    Raises:
        DeviceError: As :meth:`Approacher.approach`.
    """
    return Approacher(arm, windows, detector, config or ApproachConfig(), watchdog).approach(
        target_mm
    )


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
