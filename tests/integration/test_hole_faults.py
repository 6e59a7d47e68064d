"""Bad starts and faults on the twin: each ends in its documented error, the arm at rest."""

import numpy as np
import pytest

from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import SearchError
from spikingtac.geometry.hole import Compensation
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.arm import ArmState
from spikingtac.robot.cross_search import cross_search
from spikingtac.robot.prober import ArmProber, ProbingConfig
from spikingtac.sim.rig.hole_site import Grasp, HoleSite
from spikingtac.sim.rig.walls import HoleWall, NoWall, Wall

HOLE = HoleWall(radius_mm=1.0)
SHORT = ProbingConfig(speed_mm_s=4.0, travel_limit_mm=1.2, travel_speed_mm_s=8.0, rest_windows=40)


def run(wall: Wall, start: tuple[float, float], adaptive: bool = False) -> HoleSite:
    """Search, expect the caller's error, and check that the arm rests and nothing is pushed."""
    site = HoleSite(Grasp.of(1000), 1)
    windows = site.windows()
    detector = make_detector(
        "event_count", DetectionConfig(), [site.calibration], [next(windows) for _ in range(150)]
    )
    site.set_wall(wall, np.array(start))
    prober = ArmProber(site.rig.arm, windows, detector, SHORT, free_travel=site.free_travel)
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


@pytest.mark.parametrize(("adaptive", "start_mm"), [(False, 0.75), (True, 0.75), (False, 1.2)])
def test_on_the_rim_there_is_no_room(adaptive: bool, start_mm: float) -> None:
    """The bit leans on the wall: it answers when it is pressed on, and when it is let go."""
    with pytest.raises(SearchError, match=r"make no circle|on the rim|no wall"):
        run(HOLE, (start_mm, 0.0), adaptive=adaptive)
