"""One touch: approach a wall, record the position of the arm, and back off (Section V-C).

All motions are in a plane: the probe stands in a hole and moves in x and y at constant height.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from spikingtac.contact.detector import ContactDetector, Window, count_of
from spikingtac.errors import ConfigError, DeviceError, SearchError
from spikingtac.robot.approacher import Approach, ApproachConfig, approach, next_window
from spikingtac.robot.arm import Arm
from spikingtac.robot.watchdog import Watchdog
from spikingtac.types import FloatArray

# Stiffness of the grasped probe at its tip, N/mm (twin.md: at 40 mm stick-out).
TIP_STIFFNESS_N_MM = 0.04


# Windows between reaching the speed of a touch and listening (the rod is hardly excited by such a
# slow start, and a narrow hole has no room for more).
SETTLE_WINDOWS = 20
REST_WINDOWS = 50  # Windows to wait after a motion in free air (one time constant of the rod).


class Style(NamedTuple):
    """Speeds and lengths of a touch.

    Attributes:
        speed_mm_s: Speed of the touch that counts, mm/s.
        travel_speed_mm_s: Speed of back-off and free travel, mm/s (slow enough that the rod
            does not swing, v / omega = 0.03 mm).
        find_speed_mm_s: Speed of the touch that only finds the wall, mm/s.
        conditioning_mm: How far to press on after finding the wall, mm; 0 counts the first touch.
        back_off_mm: Distance of the retreat from the place of contact, mm.
    """

    speed_mm_s: float
    travel_speed_mm_s: float
    find_speed_mm_s: float
    conditioning_mm: float
    back_off_mm: float


PUBLISHED = Style(0.8, 5.0, 4.0, 0.0, 0.6)  # Speed 0.8 mm/s: Section V-C.

# What the pixels remember of earlier contacts moves the decision by up to 0.2 mm; a press that
# takes every pixel across its thresholds, and back, leaves the same memory each time.
CONDITIONED = Style(3.0, 8.0, 6.0, 0.4, 0.4)


@dataclass(frozen=True, kw_only=True)
class ProbingConfig:
    """The settings of a touch.

    Attributes:
        conditions: Whether to find the wall, press on, back off, and touch again; the first touch
            counts otherwise, as published.
        travel_limit_mm: Largest travel of one approach, mm.
        force_limit_n: Largest force of the tip, N, even if the wall is never detected.
    """

    conditions: bool = False
    travel_limit_mm: float = 11.0
    force_limit_n: float = 0.5

    def __post_init__(self) -> None:
        if not (self.travel_limit_mm > 0.0 and self.force_limit_n > 0.0):
            raise ConfigError("travel_limit_mm and force_limit_n must be above 0")

    @property
    def style(self) -> Style:
        """Speeds and lengths of the touch."""
        return CONDITIONED if self.conditions else PUBLISHED

    @property
    def reach_mm(self) -> float:
        """Largest travel of one approach, mm: pressing all the way stays below the force limit."""
        return min(self.travel_limit_mm, self.force_limit_n / TIP_STIFFNESS_N_MM)


@dataclass(frozen=True, slots=True)
class Touched:
    """One wall contact.

    Attributes:
        start_mm: ``(2,)`` where the approach began, mm.
        direction: ``(2,)`` unit vector of the approach.
        reading_mm: ``(2,)`` the arm's position at the decision, as the controller reported it, mm.
    """

    start_mm: FloatArray
    direction: FloatArray
    reading_mm: FloatArray

    @property
    def run_mm(self) -> float:
        """Travel of the arm from the start of the approach to the decision, mm."""
        return float((self.reading_mm - self.start_mm) @ self.direction)


class Prober(Protocol):
    """Touches walls and returns the places of contact; the searches need no more of an arm."""

    def place_mm(self) -> FloatArray:
        """Return the position of the probe ``(2,)``, mm."""
        ...

    def touch(self, start_mm: FloatArray, direction: FloatArray) -> Touched:
        """Go to a place, approach in a direction until contact, and back off.

        Args:
            start_mm: ``(2,)`` where to begin, inside the hole, mm.
            direction: ``(2,)`` unit vector.

        Raises:
            SearchError: No wall was detected within the limits; the arm is at rest.
            DeviceError: Arm or sensor failed; the arm was commanded to stop.
        """
        ...


# Brings the probe through free air to a start ``(2,)`` of an approach in a direction ``(2,)``, or
# as far ahead of it as the air is free: the twin's fast path. Where it says False, the arm moves.
FreeTravel = Callable[[FloatArray, FloatArray], bool]

MOST_TRIES = 3  # Number of pairs of touches before an error; about one touch in a hundred is false.

# Largest distance of finding and measuring touch, mm; beyond it, one of them is false (five
# times the spread of a touch).
AGREE_MM = 0.12


@dataclass
class ArmProber:
    """Touches with an arm, a stream of windows and a detector.

    Args:
        arm: The arm, at rest, the probe in the hole.
        windows: Regular windows of the sensor.
        detector: Decides on contact.
        config: The settings of a touch.
        watchdog: Checked with every window of a touch; its self-test has passed.
        free_travel: Moves the arm through free air in place of the arm's own motion.

    Attributes:
        touches: Number of touches of a wall.
    """

    arm: Arm
    windows: Iterator[Window]
    detector: ContactDetector
    config: ProbingConfig
    watchdog: Watchdog | None = None
    free_travel: FreeTravel | None = None
    touches: int = field(default=0, init=False)
    _heard: int = field(default=0, init=False)  # events of the present approach

    def place_mm(self) -> FloatArray:
        """Return where the controller says that the probe stands ``(2,)``, mm."""
        return self.arm.pose().position_mm[:2]

    def touch(self, start_mm: FloatArray, direction: FloatArray) -> Touched:
        """Go, approach and back off; see :class:`Prober`. The watchdog is armed meanwhile."""
        start = np.asarray(start_mm, np.float64)
        heading = np.asarray(direction, np.float64) / float(np.linalg.norm(direction))
        if self.watchdog is not None:
            self.watchdog.arm()
        if self.free_travel is None or not self.free_travel(start, heading):
            self._move(start)
        found = (self._conditioned if self.config.conditions else self._meet)(start, heading)
        if self.watchdog is not None:  # nobody reads the stream while the arm rests
            self.watchdog.disarm()
        return found

    def _conditioned(self, start: FloatArray, heading: FloatArray) -> Touched:
        """Find the wall, press on, back off, and measure; again where both do not agree."""
        apart_mm, style = 0.0, self.config.style
        for _ in range(MOST_TRIES):
            found = self._meet(start, heading, style.find_speed_mm_s, style.conditioning_mm)
            measured = self._meet(start, heading)
            apart_mm = float((measured.reading_mm - found.reading_mm) @ heading)
            if abs(apart_mm) <= AGREE_MM:
                return measured
        raise SearchError(
            f"finding and measuring touch differ by {apart_mm:.2f} mm in {MOST_TRIES} tries at "
            f"({start[0]:.2f}, {start[1]:.2f}) mm; something moves, or the sensor gives false "
            "contacts: calibrate its quiet windows anew"
        )

    def _meet(
        self, start: FloatArray, heading: FloatArray, speed_mm_s: float = 0.0, press_mm: float = 0.0
    ) -> Touched:
        """Approach from where the arm stands until contact, press on, and move back.

        Args:
            start: ``(2,)`` where the touch began, mm.
            heading: ``(2,)`` unit vector.
            speed_mm_s: Speed, mm/s; that of the touch that counts unless given.
            press_mm: How far to press on, mm.
        """
        self.detector.reset()
        self._heard, reach_mm = 0, self.config.reach_mm
        speed_mm_s = speed_mm_s or self.config.style.speed_mm_s
        met = self._approach(start + reach_mm * heading, speed_mm_s, self.detector)
        if met.contact is not None and met.collision_mm is not None:
            self.touches += 1
            found = Touched(start, heading, met.collision_mm[:2])
            if press_mm > 0.0:
                self._move(found.reading_mm + press_mm * heading, rest=False)
            # At most back to the start, which was free.
            back_mm = min(max(found.run_mm, 0.0), self.config.style.back_off_mm)
            self._move(found.reading_mm - back_mm * heading)
            return found
        heard = self._heard
        self._move(start)
        if not heard:  # leak and vibration cause some events while the sensor works
            raise DeviceError(
                "the sensor gave no event in an approach of a moving arm: it is "
                "dead, covered or masked; check the camera before anything else moves"
            )
        raise SearchError(
            f"no wall within {reach_mm:g} mm of ({start[0]:.2f}, {start[1]:.2f}) mm towards "
            f"{float(np.degrees(np.arctan2(heading[1], heading[0]))):.0f} degrees: the start is "
            "outside a hole, the hole is larger than the travel limit, or the touch was not felt; "
            "check the start, or raise travel_limit_mm"
        )

    def _move(self, to_mm: FloatArray, rest: bool = True) -> None:
        """Move without detection, and wait on request until the rod is at rest."""
        self._approach(to_mm, self.config.style.travel_speed_mm_s, None)
        for _ in range(REST_WINDOWS if rest else 0):
            next_window(self.windows, self.watchdog)

    def _approach(
        self, to_mm: FloatArray, speed_mm_s: float, detector: ContactDetector | None
    ) -> Approach:
        settings = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE_WINDOWS)
        target_mm = np.array([*to_mm, self.arm.pose().position_mm[2]])
        return approach(self.arm, self._counted(), detector, target_mm, settings, self.watchdog)

    def _counted(self) -> Iterator[Window]:
        for window in self.windows:
            self._heard += count_of(window)
            yield window
