"""How far the tip travels from the first touch to the first events (twin.md, section 0).

Simulated, preset ``typical`` without noise and leak (they are no signal), at 10 mm/s, with a rod
without mass, so that only the touch moves the markers.
"""

from typing import Any

import numpy as np
import pytest

from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.probe import ProbeConfig
from spikingtac.sim.rig.rig import (
    EDGE_SETTINGS,
    STEP_SETTINGS,
    WAIT_S,
    FingerConfig,
    PriorContact,
    Rig,
    RigConfig,
    SensingFinger,
)
from spikingtac.sim.rig.walls import PlaneWall

FREE_MM = 0.2
SPEED_MM_S = 10.0
SILENT = {"background": {"rate_hz": 0.0, "hot_fraction": 0.0}, **EDGE_SETTINGS, **STEP_SETTINGS}
LATERAL, AXIAL = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)


def press_and_release(rig: Rig, reach_mm: np.ndarray, config: PriorContact) -> None:
    """Touch the wall at ``reach_mm`` ``(3,)`` from here, return, wait, and drop the events."""
    home_mm = rig.arm.true_position_mm()
    way_mm = reach_mm * (1.0 + config.press_mm / float(np.linalg.norm(reach_mm)))
    rig.arm.move_linear(home_mm + way_mm, config.speed_mm_s)
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)
    rig.wait(config.hold_s)
    rig.arm.move_linear(home_mm, config.speed_mm_s)
    while rig.state.in_contact:
        rig.wait(WAIT_S)
    released_us = rig.t_us
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)
    rig.wait(max(config.wait_s - (rig.t_us - released_us) * 1e-6, 0.0))
    rig.reset_first_contact()


def make_rig(
    direction: tuple[float, ...], stickout_mm: float, leak: bool, history: Any, seed: int
) -> Rig:
    way = np.array(direction)
    wall = PlaneWall(point_mm=tuple(way * (0.375 + FREE_MM)), normal=tuple(-way))
    settings = SILENT if leak else {**SILENT, "pixel": {"leak_hz": 0.0}}
    finger = SensingFinger(FingerConfig(settings=settings, history=history, serial=seed), seed)
    config = RigConfig(
        probe=ProbeConfig(stickout_mm=stickout_mm, grams_per_mm=0.0),
        vibration_mm=0.0,
    )
    return Rig(config, wall, [finger], np.zeros(3), np.random.default_rng(seed))


def travel_mm(
    direction: tuple[float, ...] = LATERAL,
    stickout_mm: float = 40.0,
    history: str = "fresh",
    seed: int = 1,
) -> tuple[float, float]:
    """Return the arm's travel from the touch to the 20th and the 100th event, mm."""
    way = np.array(direction)
    rig = make_rig(direction, stickout_mm, history == "rested", "fresh", seed)
    if history == "rested":
        rig = make_rig(direction, stickout_mm, True, "rested", seed)
    if history == "released":
        press_and_release(rig, FREE_MM * way, PriorContact())
    rig.arm.move_linear(2.0 * way, SPEED_MM_S)
    times: list[int] = []
    while len(times) < 100:
        (packet,), _ = rig.advance(1000)
        if rig.first_contact is not None:
            times += packet.t[packet.t >= rig.first_contact.t_us].tolist()
    assert rig.first_contact is not None
    touched = rig.first_contact.arm_mm
    first, second = (float((rig.arm.position_at_mm(times[n]) - touched) @ way) for n in (19, 99))
    return first, second


@pytest.fixture(scope="module")
def fresh() -> tuple[float, float]:
    return travel_mm()


def test_fresh_references(fresh: tuple[float, float]) -> None:
    assert fresh == pytest.approx((0.11, 0.145), rel=0.25)


def test_references_inherited_from_a_contact_released_one_second_ago(
    fresh: tuple[float, float],
) -> None:
    released = travel_mm(history="released")
    assert released == pytest.approx((0.145, 0.20), rel=0.25)
    assert released[0] > 1.1 * fresh[0]


def test_references_that_rested_for_a_minute() -> None:
    first, second = np.mean([travel_mm(history="rested", seed=seed) for seed in (1, 2, 3)], axis=0)
    assert 0.5 <= first / 0.01 <= 2.0
    assert 0.5 <= second / 0.03 <= 2.0


def test_an_axial_load_is_found_soonest() -> None:
    assert travel_mm(AXIAL) == pytest.approx((0.02, 0.03), rel=0.25)
