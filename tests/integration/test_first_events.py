"""How far the tip travels from the first touch to the first events (twin.md, section 0).

Simulated, preset ``typical`` without noise and leak (they are no signal), at 10 mm/s, with a rod
without mass, so that only the touch moves the markers.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spikingtac.robot.arm import ArmState
from spikingtac.sim.camera.config import BackgroundConfig
from spikingtac.sim.camera.event_camera import EventCamera, ReferenceHistory
from spikingtac.sim.rig import probe
from spikingtac.sim.rig.rig import STILL_PX, Rig, SensingFinger, grip_camera
from spikingtac.sim.rig.ur3 import UR3Twin
from spikingtac.sim.rig.walls import PlaneWall

FREE_MM = 0.2
SPEED_MM_S = 10.0
WAIT_S = 0.001
LATERAL, AXIAL = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)


@pytest.fixture(autouse=True, scope="module")
def rod_without_mass() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        probe.step_matrices.cache_clear()
        patch.setattr(probe, "GRAMS_PER_MM", 0.0)
        yield
    probe.step_matrices.cache_clear()


class SilentFinger(SensingFinger):
    """A finger without background, and without leak unless its pixels had time to rest."""

    def __init__(self, seed: int, history: ReferenceHistory) -> None:
        super().__init__("typical", seed, serial=seed)
        whole = grip_camera("typical")
        pixel = whole.pixel if history == "rested" else replace(whole.pixel, leak_hz=0.0)
        silent = replace(whole, background=BackgroundConfig(), pixel=pixel)
        self.camera = EventCamera(silent, self.camera.size, seed, seed, STILL_PX)


def press_and_release(rig: Rig, reach_mm: np.ndarray) -> None:
    """Touch the wall at ``reach_mm`` ``(3,)`` from here, return, wait, and drop the events."""
    home_mm = rig.arm.true_position_mm()
    rig.arm.move_linear(home_mm + reach_mm * (1.0 + 1.0 / float(np.linalg.norm(reach_mm))), 20.0)
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)
    rig.wait(0.2)
    rig.arm.move_linear(home_mm, 20.0)
    while rig.state.in_contact:
        rig.wait(WAIT_S)
    released_us = rig.t_us
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)
    rig.wait(max(1.0 - (rig.t_us - released_us) * 1e-6, 0.0))
    rig.first_contact = None


def travel_mm(
    direction: tuple[float, ...] = LATERAL, history: str = "fresh", seed: int = 1
) -> tuple[float, float]:
    """Return the arm's travel from the touch to the 20th and the 100th event, mm."""
    way = np.array(direction)
    known: Any = "fresh" if history == "released" else history
    finger = SilentFinger(seed, known)
    wall, rng = PlaneWall(way * (0.375 + FREE_MM), -way), np.random.default_rng(seed)
    rig = Rig(UR3Twin(np.zeros(3), rng), wall, finger, rng, vibration_mm=0.0)
    finger.camera.settle(rig.image, known)
    if history == "released":
        press_and_release(rig, FREE_MM * way)
    rig.arm.move_linear(2.0 * way, SPEED_MM_S)
    times: list[int] = []
    while len(times) < 100:
        packet = rig.advance(1000)
        if rig.first_contact is not None:
            times += packet.t[packet.t >= rig.first_contact.t_us].tolist()
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
