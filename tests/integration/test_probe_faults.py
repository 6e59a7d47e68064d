"""Bad starts and faults of a search: exit code, message, arm at rest, little force, no output."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac import robot
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.cli import probe_sites as sites
from spikingtac.cli.verbs.probe import Args
from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import EventCountDetector
from spikingtac.robot.arm import Arm, ArmState
from spikingtac.sim.rig.hole_site import HoleSite
from spikingtac.sim.rig.walls import HoleWall, NoWall, Wall
from spikingtac.types import EventPacket
from stand_ins.verbs import Verbs

FORCE_LIMIT_N = 0.05  # Ten times below what is allowed unless told: 1.25 mm of push.
QUIET = 150

# A probe that is put onto a rim from one step to the next is knocked off it at first; the arm
# does not move yet.
PLACING_WINDOWS = 30
Window = tuple[EventPacket, ...]


class Watched:
    """A site of the twin whose force is looked at with every window."""

    def __init__(self) -> None:
        self.site = HoleSite(1000, 1)
        self.most_n = 0.0
        self.pulled = 0
        self._since_placed = 0
        self._set_wall = self.site.set_wall
        self.site.set_wall = self.set_wall  # type: ignore[method-assign]

    def set_wall(self, wall: Wall, place_mm: np.ndarray) -> None:
        self._since_placed = 0
        self._set_wall(wall, place_mm)

    def windows(self) -> Iterator[Window]:
        for window in self.site.rig.windows():
            self.pulled += 1
            self._since_placed += 1
            if self._since_placed > PLACING_WINDOWS:
                self.most_n = max(self.most_n, float(np.linalg.norm(self.site.rig.state.force_n)))
            yield window

    def require_rest(self) -> None:
        self.site.rig.advance(300_000)
        assert self.site.rig.arm.state() is not ArmState.MOVING
        assert self.pulled > 0
        assert self.most_n < FORCE_LIMIT_N
        assert float(np.linalg.norm(self.site.rig.state.force_n)) < FORCE_LIMIT_N


Fault = Callable[[Iterator[Window], HoleSite], Iterator[Window]]


def ending(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
    for _ in range(120):
        yield next(windows)


def dying(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
    for window in windows:
        yield tuple(EventPacket.empty(p.t_start_us, p.t_end_us, p.size) for p in window)


def stopping(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
    for window in windows:
        if site.rig.arm.state() is ArmState.MOVING:
            site.rig.arm.protective_stop()
        yield window


def whole(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
    yield from windows


def outside(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
    yield from windows


def deaf(*built_from: object) -> ContactDetector:
    return EventCountDetector(1e9)


@pytest.mark.parametrize(
    ("fault", "code", "message"),
    [
        (ending, 3, "stream ended"),
        (dying, 3, "gave no event in"),
        (stopping, 3, "stopped by itself: protective stop"),
        (whole, 1, "the touch was not felt"),
        (outside, 1, "no wall within 1.2 mm"),
    ],
    ids=["the stream ends", "the sensor dies", "the arm stops by itself", "no signal", "no hole"],
)
def test_a_fault_of_an_arm(
    fault: Fault, code: int, message: str, monkeypatch: pytest.MonkeyPatch,
    verbs: Verbs, tmp_path: Path,
) -> None:  # fmt: skip
    """The twin's arm and finger behind ``--arm``: everything else is the verb's own."""
    watched = Watched()
    watched.site.calibration.save(tmp_path / "finger.json")
    stream = watched.windows()

    def listen(args: Args, calibration: Calibration) -> Iterator[Window]:
        for _ in range(QUIET):
            yield next(stream)
        yield from fault(stream, watched.site)

    def connect(address: str) -> Arm:
        wall = NoWall() if fault is outside else HoleWall(radius_mm=0.7)
        watched.site.set_wall(wall, np.zeros(2))
        return watched.site.rig.arm

    monkeypatch.setattr(sites, "QUIET_WINDOWS", QUIET)
    monkeypatch.setattr(sites, "listen", lambda args, own: (listen(args, own), None))
    monkeypatch.setattr(robot, "URArm", connect)
    if fault is whole:
        monkeypatch.setattr(st, "make_detector", deaf)
    finger = ["--events", "finger.raw", "--calibration", tmp_path / "finger.json"]
    given = ["--arm", "192.0.2.1", *finger, "--rehearsal", "--detector", "event_count"]
    limits = "--force-limit-n", FORCE_LIMIT_N, "--travel-limit-mm", 1.2
    told = verbs.told("probe", *given, *limits, "-o", tmp_path / "out", code=code)
    assert list((tmp_path / "out").iterdir()) == []
    assert message in told["error"]
    watched.require_rest()
