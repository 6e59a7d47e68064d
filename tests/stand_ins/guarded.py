"""What a contact process is made of in tests: paced streams that fail, and an arm that notes."""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, EventCountDetector, make_detector
from spikingtac.errors import DeviceError
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.robot.guard_loop import Arrival
from spikingtac.types import EventPacket, Pose
from stand_ins.moving_rims import PERIOD_US, calibration, still, windows

NEVER = 1 << 30
SLOWED = 5  # Host time and sensor time of a window, in periods of the detector.


def slowed(window: EventPacket) -> EventPacket:
    """Return a window whose time runs slower, so that a busy machine keeps up."""
    begin_us, end_us = (SLOWED * t for t in (window.t_start_us, window.t_end_us))
    return replace(window, t=SLOWED * window.t, t_start_us=begin_us, t_end_us=end_us)


class NotingArm:
    """Writes the time of each stop into a file; knows nothing else."""

    def __init__(self, notes: str) -> None:
        self._notes = Path(notes)

    def stop(self) -> None:
        with self._notes.open("a", encoding="utf-8") as file:
            file.write(f"{time.monotonic()}\n")

    def confirm_stop(self) -> None:
        """It rests at once."""

    def pose(self) -> Pose:
        return Pose(np.zeros(3))

    def speed_mm_s(self) -> np.ndarray:
        return np.zeros(3)

    def move_linear(self, target_mm: np.ndarray, speed_mm_s: float) -> None:
        del target_mm, speed_mm_s

    def state(self) -> ArmState:
        return ArmState.MOVING

    close = stop


SLOW_S = 1.5  # For so long an arm that is slow to tell its state holds up the loop of its guard, s.


class SlowArm(NotingArm):
    """Takes long to tell its state from one question to another; they are counted from 1."""

    def __init__(self, notes: str, slow: tuple[int, int]) -> None:
        super().__init__(notes)
        self._slow, self._asked = slow, 0

    def state(self) -> ArmState:
        self._asked += 1
        if self._slow[0] <= self._asked <= self._slow[1]:
            time.sleep(SLOW_S)
        return super().state()


def stops(notes: Path) -> list[float]:
    return [float(line) for line in notes.read_text().split()] if notes.exists() else []


def detector() -> ContactDetector:
    quiet = map(slowed, windows(1000, seed=1))
    return make_detector("default", DetectionConfig(), [calibration()], quiet)


def watching(stream: Mapping[str, int]) -> Callable[[], ContactDetector]:
    """Return the detector for a stream of :func:`paced`: one that hears nothing where none touches.

    What stalls, ends, breaks or leaps is noticed by whoever watches the stream, not by a detector.
    """
    if "touch" in stream:
        return detector
    return partial(EventCountDetector, 1e9)


def sliding(window: int) -> tuple[float, float]:
    return 0.1, 0.0


def paced(
    touch: int = NEVER, stall: int = NEVER, end: int = NEVER, fault: int = NEVER, begin: str = ""
) -> Iterator[Arrival]:
    """Yield windows of 5 ms in real time; touch, stall, end or break at a window.

    It is counted from the first one, or from when a file ``begin`` is there.
    """
    due_s, counted = time.monotonic(), itertools.count()
    for number in itertools.count():
        at = next(counted) if not begin or Path(begin).exists() else -1
        if at == end:
            return
        if at == fault:
            raise OSError("the camera was unplugged")
        if at == stall:
            time.sleep(600.0)
        speed = sliding if at >= touch else still
        (window,) = windows(1, seed=number, speed=speed, first=number)
        due_s += SLOWED * PERIOD_US * 1e-6
        time.sleep(max(due_s - time.monotonic(), 0.0))
        yield Arrival(slowed(window), time.monotonic())


BEGUN_MM_S = 10.0  # Speed above which the arm has begun to move, mm/s.


def moving_ur(host: str, speed_mm_s: float, watchdog_hz: float) -> Arm:
    """Return the real driver, whose arm has begun to move once the stream begins."""
    from spikingtac.robot import ur

    ur.WATCHDOG_HZ = watchdog_hz  # in the guard's process
    return MovingArm(ur.URArm(host), speed_mm_s)


class MovingArm:
    """Starts the motion at the first look around, after the watchdog's self-test has stopped it."""

    def __init__(self, arm: Arm, speed_mm_s: float) -> None:
        self._arm, self._speed_mm_s, self._moving = arm, speed_mm_s, False
        self.pose, self.stop, self.close = arm.pose, arm.stop, arm.close
        self.confirm_stop = arm.confirm_stop
        self.speed_mm_s, self.move_linear = arm.speed_mm_s, arm.move_linear

    def state(self) -> ArmState:
        state = self._arm.state()
        if not self._moving and state is ArmState.IDLE:
            far = self._arm.pose().position_mm + np.array([800.0, 0.0, 0.0])
            with contextlib.suppress(DeviceError):  # a busy machine: at the next look
                self._arm.move_linear(far, self._speed_mm_s)
                self._moving = True
        if not self._moving and state is ArmState.MOVING:
            with contextlib.suppress(DeviceError):  # a command answered too late has begun it, too
                self._moving = float(np.linalg.norm(self._arm.speed_mm_s())) > BEGUN_MM_S
        return state


def long_failure() -> ContactDetector:
    raise ValueError("\u00e9" * 10_000)
