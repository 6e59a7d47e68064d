"""One approach through the whole twin that does not stop at contact; every method observes it.

The arm is position-controlled. The outcome of a method therefore follows from the time of its
decision: a copy of the arm is stopped at that time. A test compares this with the closed loop
(:class:`~spikingtac.robot.approacher.Approacher`): decision and overshoot are the same.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact import ContactDetector
from spikingtac.robot import CRUISE_TOLERANCE, ApproachConfig, ArmState
from spikingtac.sim import FirstContact, Rig, UR3Twin
from spikingtac_paper.collision.frames import FrameSampler
from spikingtac_paper.collision.scene import (
    DIRECTION,
    NEAR_MM,
    PRIOR_TOUCH,
    RELEASED_S,
    SETTLE_WINDOWS,
    run_up_mm,
    travel_time_s,
)

Vector = NDArray[np.float64]

# Speed of the motion back to the start, mm/s: it ends within the second after a release.
RETREAT_MM_S = 180.0
WAIT_S = 0.001  # Period at which a waiting loop checks its condition, s.
BEYOND_MM = 60.0  # Distance of the commanded target behind the wall, mm: no method stops that late.
FRAMES = "frames"  # Name of the frame sampler's decision in :attr:`ApproachRun.decided_us`.
WINDOW_US = 1000  # Length of a window of the detectors, us (Section V-B).


@dataclass(frozen=True, kw_only=True)
class Observers:
    """The methods that observe an approach.

    Attributes:
        detectors: Event detectors by name, reset.
        frames: The frame sampler, or None.
        required: Detectors whose decisions end the run; it does not wait for the others.
        patience_mm: Travel of the arm after the touch at which the run ends in any case, mm.
    """

    detectors: Mapping[str, ContactDetector]
    frames: FrameSampler | None
    required: frozenset[str]
    patience_mm: float


@dataclass
class ApproachRun:
    """The record of one approach.

    Attributes:
        touch: The true first touch.
        arm: A copy of the arm at the beginning of its motion; copies of it are stopped later.
        decided_us: Method -> time of its first decision, us.
        costs_us: Detector -> histogram of its computing time per window, us.
    """

    touch: FirstContact
    arm: UR3Twin
    decided_us: dict[str, float] = field(default_factory=dict)
    costs_us: dict[str, Counter[int]] = field(default_factory=dict)


def prepare(rig: Rig, speed_mm_s: float, rng: np.random.Generator) -> None:
    """Touch the wall and release it, move to the start, and wait there until the approach is due.

    The arm begins each motion with a cycle of its controller. The start is therefore moved back at
    random by up to the travel of one cycle; from a fixed place, every touch would fall into the
    same phase of a cycle.

    Args:
        rig: A new rig of the scene.
        speed_mm_s: Speed of the approach, mm/s.
        rng: Draws the starting place.
    """
    rig.arm.move_linear(PRIOR_TOUCH["press_mm"] * DIRECTION, PRIOR_TOUCH["speed_mm_s"])
    _until_at_rest(rig)
    rig.wait(PRIOR_TOUCH["hold_s"])
    rig.arm.move_linear(-NEAR_MM * DIRECTION, PRIOR_TOUCH["speed_mm_s"])
    while rig.state.in_contact:
        rig.wait(WAIT_S)
    released_us = float(rig.t_us)
    _until_at_rest(rig)
    way_mm = run_up_mm(speed_mm_s) + rng.uniform() * speed_mm_s * UR3Twin.CYCLE_S
    rig.arm.move_linear(-way_mm * DIRECTION, RETREAT_MM_S)
    _until_at_rest(rig)
    due_us = released_us + 1e6 * (RELEASED_S - travel_time_s(speed_mm_s, way_mm))
    rig.wait(max((due_us - rig.t_us) * 1e-6, WAIT_S))
    rig.reset_first_contact()


def approach(rig: Rig, speed_mm_s: float, observers: Observers) -> ApproachRun:
    """Move the arm past the wall's place while all methods observe.

    Args:
        rig: The rig after :func:`prepare`.
        speed_mm_s: Speed of the arm, mm/s.
        observers: The methods that observe.
    """
    rig.arm.move_linear(BEYOND_MM * DIRECTION, speed_mm_s)
    arm = rig.arm.copy()
    config = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE_WINDOWS)
    before = _cruise(rig, config)
    run = ApproachRun(FirstContact(float("inf"), np.full(3, np.nan)), arm)
    run.costs_us = {name: Counter() for name in observers.detectors}
    if observers.frames is not None:
        observers.frames.start(np.mean(before, axis=0))
    known = float(rig.t_us), rig.image.center_px
    while not _has_ended(rig, observers, run):
        window = next(rig.windows())
        for name, detector in observers.detectors.items():
            if name not in run.decided_us:
                begun = time.perf_counter()
                contact = detector.update(window)
                run.costs_us[name][round((time.perf_counter() - begun) * 1e6)] += 1
                if contact is not None:
                    run.decided_us[name] = float(rig.t_us)
        before, known = known, (float(rig.t_us), rig.image.center_px)
        if observers.frames is not None and FRAMES not in run.decided_us:
            times_us, centers = (np.array(column) for column in zip(before, known, strict=True))
            found = observers.frames.look((times_us, centers))
            if found is not None:
                run.decided_us[FRAMES] = found
    if rig.first_contact is not None:
        run.touch = rig.first_contact
    return run


def _cruise(rig: Rig, config: ApproachConfig) -> list[Vector]:
    """Wait until the arm has cruised for ``settle_windows``; return the markers of these windows.

    The rule is that of :class:`~spikingtac.robot.approacher.Approacher`.
    """
    cruising, seen = 0, []
    while cruising < config.settle_windows:
        next(rig.windows())
        speed = float(rig.arm.speed_mm_s() @ DIRECTION)
        steady = abs(speed / config.speed_mm_s - 1.0) <= CRUISE_TOLERANCE
        cruising = cruising + 1 if steady else 0
        seen.append(rig.image.center_px)
    return seen[-config.settle_windows :]


def _has_ended(rig: Rig, observers: Observers, run: ApproachRun) -> bool:
    if rig.first_contact is None:
        return rig.arm.state() is not ArmState.MOVING
    required = observers.required | ({FRAMES} if observers.frames is not None else set())
    if required <= set(run.decided_us):
        return True
    travel = rig.arm.true_position_mm() - rig.first_contact.arm_mm
    return float(np.linalg.norm(travel)) > observers.patience_mm


def _until_at_rest(rig: Rig) -> None:
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)


def stop_at(run: ApproachRun, decided_us: float) -> dict[str, float]:
    """Return where the arm is at a decision, truly and as it reports, and where it comes to rest.

    A copy of the run's arm is stopped. Positions are along the approach, mm from the true first
    touch; ``delay_us`` is the time from there.
    """
    arm, real = run.arm.copy(), run.touch.arm_mm
    now_us = round(decided_us)
    arm.advance_to(now_us)
    deviation = float((arm.true_position_mm() - real) @ DIRECTION)
    read = float((arm.pose().position_mm - real) @ DIRECTION)
    arm.stop()
    while arm.state() is ArmState.MOVING:
        now_us += WINDOW_US
        arm.advance_to(now_us)
    overshoot = float((arm.true_position_mm() - real) @ DIRECTION)
    return {
        "deviation_mm": deviation,
        "read_mm": read,
        "overshoot_mm": overshoot,
        "delay_us": decided_us - run.touch.t_us,
    }
