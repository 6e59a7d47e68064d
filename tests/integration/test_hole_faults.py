"""Bad starts and faults on the twin: each ends in its documented error, the arm at rest."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import DeviceError, SearchError
from spikingtac.geometry.hole import Compensation
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.arm import ArmState
from spikingtac.robot.cross_search import cross_search
from spikingtac.robot.prober import ArmProber, ProbingConfig
from spikingtac.sim.rig.hole_site import Grasp, HoleSite
from spikingtac.sim.rig.walls import HoleWall, NoWall, Wall
from spikingtac.types import EventPacket

HOLE = HoleWall(radius_mm=1.0)
SHORT = ProbingConfig(speed_mm_s=4.0, travel_limit_mm=1.2, travel_speed_mm_s=8.0, rest_windows=40)
Window = tuple[EventPacket, ...]
Stream = Callable[[Iterator[Window], HoleSite], Iterator[Window]]


def run(
    wall: Wall, start: tuple[float, float], stream: Stream | None = None, adaptive: bool = False
) -> HoleSite:
    """Search, expect the caller's error, and check that the arm rests and nothing is pushed."""
    site = HoleSite(Grasp.of(1000), 1)
    windows = site.windows()
    detector = make_detector(
        "event_count", DetectionConfig(), [site.calibration], [next(windows) for _ in range(150)]
    )
    site.set_wall(wall, np.array(start))
    heard = stream(windows, site) if stream else windows
    prober = ArmProber(site.rig.arm, heard, detector, SHORT, free_travel=site.free_travel)
    try:
        travel = TravelModel.of(Compensation(travel_mm=0.12))
        if adaptive:
            AdaptiveSearch(prober, travel, AdaptiveSearchConfig()).run(np.array(start))
        else:
            cross_search(prober, np.array(start), travel)
    finally:
        site.rig.advance(300_000)
        assert site.rig.arm.state() is not ArmState.MOVING
        assert float(np.linalg.norm(site.rig.state.force_n)) < SHORT.force_limit_n
    return site


@pytest.mark.parametrize("adaptive", [False, True])
def test_outside_a_hole_there_is_no_wall(adaptive: bool) -> None:
    with pytest.raises(SearchError, match=r"no wall within 1\.2 mm"):
        run(NoWall(), (0.0, 0.0), adaptive=adaptive)


def test_a_hole_beyond_the_travel_limit() -> None:
    with pytest.raises(SearchError, match="larger than the travel limit"):
        run(HoleWall(radius_mm=5.0), (0.0, 0.0))


@pytest.mark.parametrize(("adaptive", "start_mm"), [(False, 0.75), (True, 0.75), (False, 1.2)])
def test_on_the_rim_there_is_no_room(adaptive: bool, start_mm: float) -> None:
    """The bit leans on the wall: it answers when it is pressed on, and when it is let go."""
    with pytest.raises(SearchError, match=r"make no circle|on the rim|no wall"):
        run(HOLE, (start_mm, 0.0), adaptive=adaptive)


def test_a_stream_that_ends_stops_the_arm() -> None:
    def ending(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
        for _ in range(120):
            yield next(windows)

    with pytest.raises(DeviceError, match="stream ended"):
        run(HOLE, (0.0, 0.0), ending)


def test_a_dead_sensor_is_told_from_a_missing_wall() -> None:
    def dead(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
        for window in windows:
            yield tuple(EventPacket.empty(p.t_start_us, p.t_end_us, p.size) for p in window)

    with pytest.raises(DeviceError, match="gave no event"):
        run(HOLE, (0.0, 0.0), dead)


def test_an_arm_that_stops_by_itself() -> None:
    def stopping(windows: Iterator[Window], site: HoleSite) -> Iterator[Window]:
        for number, window in enumerate(windows):
            if number == 30:
                site.rig.arm.protective_stop()
            yield window

    with pytest.raises(DeviceError, match="stopped by itself: protective stop"):
        run(HOLE, (0.0, 0.0), stopping)


def test_a_detector_that_hears_nothing_ends_below_the_force_limit() -> None:
    """The wall is there, the sensor lives, the threshold is out of reach."""
    site = HoleSite(Grasp.of(1000), 1)
    deaf = EventCountDetector(EventCountConfig(threshold=1e9))
    site.set_wall(HOLE, np.zeros(2))
    prober = ArmProber(site.rig.arm, site.windows(), deaf, SHORT, free_travel=site.free_travel)
    with pytest.raises(SearchError, match="the touch was not felt"):
        cross_search(prober, np.zeros(2))
    assert site.rig.arm.state() is ArmState.IDLE
    assert not site.rig.state.in_contact
