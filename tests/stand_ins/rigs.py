"""The rig of contract.md's "Pinned physics", and the contact that precedes an experiment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.rig import (
    VIBRATION_MM,
    WAIT_S,
    FingerConfig,
    PriorContact,
    Rig,
    RigConfig,
    SensingFinger,
)
from spikingtac.sim.rig.walls import Wall

FINGERS = 2


def pinned_rig(preset: str, wall: Wall, start_mm: Sequence[float], seed: int) -> Rig:
    """Return a rig with two fingers and the vibration of a camera preset."""
    fingers = [
        SensingFinger(FingerConfig(camera=preset, serial=1 + k), FINGERS * seed + k)
        for k in range(FINGERS)
    ]
    rng = np.random.default_rng(seed)
    config = RigConfig(vibration_mm=VIBRATION_MM[preset])
    return Rig(config, wall, fingers, np.array(start_mm, np.float64), rng)


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
