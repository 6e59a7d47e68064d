"""Arm, probe, gel, cameras, detector: move until contact on the twin, as pinned (simulated)."""

from collections.abc import Callable
from itertools import islice

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.robot.approacher import Approach, ApproachConfig, Approacher
from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.rig import PriorContact, Rig
from spikingtac.sim.rig.walls import PlaneWall
from spikingtac.types import EventPacket
from stand_ins.rigs import pinned_rig, press_and_release

FREE_MM = 45.0
WALL = PlaneWall(point_mm=(FREE_MM + 0.375, 0.0, 0.0))
SETTLE = 100


RADIUS_PX = 7.0  # Nominal radius of a disc; in the grip it shows as up to 7.5.


def moving(rig: Rig, speed_mm_s: float, windows: int) -> list[tuple[EventPacket, ...]]:
    """Return windows of the moving arm without contact, and bring it to rest."""
    home = rig.arm.true_position_mm()
    rig.arm.move_linear(home - np.array([1e3, 0.0, 0.0]), speed_mm_s)
    pairs = rig.paired_windows()
    for _ in range(SETTLE + 150):
        next(pairs)
    quiet = list(islice(pairs, windows))
    rig.arm.stop()
    while rig.arm.state() is ArmState.MOVING:
        next(pairs)
    return quiet


def default(rig: Rig, speed_mm_s: float) -> ContactDetector:
    calibrations = [
        Calibration(
            reference_px=markers, radius_px=np.full(64, RADIUS_PX), grid=(8, 8), size=(320, 320)
        )
        for markers in rig.markers_px
    ]
    quiet = moving(rig, speed_mm_s, 500)
    return make_detector("default", DetectionConfig(), calibrations, quiet)


def run(
    preset: str, speed_mm_s: float, seed: int, build: Callable[[Rig, float], ContactDetector]
) -> tuple[Approach, Rig]:
    rig = pinned_rig(preset, WALL, (FREE_MM - 0.5, 0.0, 0.0), seed)
    press_and_release(rig, np.array([0.5, 0.0, 0.0]), PriorContact(wait_s=0.0))
    detector = build(rig, speed_mm_s)
    rig.reset_first_contact()
    config = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE)
    approacher = Approacher(rig.arm, rig.paired_windows(), detector, config)
    return approacher.approach(np.array([FREE_MM + 40.0, 0.0, 0.0])), rig


def test_the_default_detector_stops_it_sooner_than_the_budgeted_deviation() -> None:
    found, rig = run("typical", 180.0, seed=1, build=default)
    assert found.contact is not None
    assert rig.first_contact is not None
    assert 0.05 < found.deviation_mm(rig.first_contact.arm_mm) < 0.45
    assert 0.0 < found.contact.t_us - rig.first_contact.t_us < 2_500.0
