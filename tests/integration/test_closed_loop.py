"""Arm, probe, gel, cameras, detector: move until contact on the twin, as pinned (simulated)."""

import numpy as np

from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.robot.approach import Approach, ApproachConfig, Approacher
from spikingtac.robot.arm import ArmState
from spikingtac.sim.fingers import pinned_rig
from spikingtac.sim.rig import HistoryTouch, Rig
from spikingtac.sim.walls import PlaneWall

FREE_MM = 45.0
WALL = PlaneWall(point_mm=(FREE_MM + 0.375, 0.0, 0.0))
SETTLE = 100


def detector_for(rig: Rig, speed_mm_s: float) -> EventCountDetector:
    """Return the published detector, calibrated on the moving arm without contact."""
    home = rig.arm.true_position_mm()
    rig.arm.move_linear(home - np.array([1e3, 0.0, 0.0]), speed_mm_s)
    windows = rig.windows()
    for _ in range(SETTLE + 150):
        next(windows)
    quiet = QuietStatistics.of(next(windows) for _ in range(200))
    rig.arm.stop()
    while rig.arm.state() is ArmState.MOVING:
        next(windows)
    return EventCountDetector(EventCountConfig.from_quiet(quiet))


def run(preset: str, speed_mm_s: float, seed: int) -> tuple[Approach, Rig]:
    rig = pinned_rig(preset, WALL, (FREE_MM - 0.5, 0.0, 0.0), seed)
    rig.press_and_release(np.array([0.5, 0.0, 0.0]), HistoryTouch(wait_s=0.0))
    detector = detector_for(rig, speed_mm_s)
    rig.forget_touch()
    config = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE)
    approacher = Approacher(rig.arm, rig.windows(), detector, config)
    return approacher.approach(np.array([FREE_MM + 40.0, 0.0, 0.0])), rig


def test_the_published_detector_stops_the_arm_at_full_speed() -> None:
    found, rig = run("typical", 180.0, seed=1)
    assert found.contact is not None
    assert rig.touch is not None
    deviation = found.deviation_mm(rig.touch.arm_mm)
    assert 0.05 < deviation < 0.8
    assert 4.5 < found.overshoot_mm(rig.touch.arm_mm) - deviation < 7.7
    assert rig.arm.state() is ArmState.IDLE
    assert rig.state.in_contact
    assert abs(rig.state.force_n[0]) < 0.4
