"""One approach through the whole twin that does not stop at contact, watched by every method.

The arm is position-controlled, so what a method would have made of it follows from when it decides:
a fork of the arm is told to stop then. ``tests/integration/test_collision_experiment.py`` holds it
to the closed loop (:class:`~spikingtac.robot.approach.Approacher`): same decision and overshoot.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.baselines.frame_sampling import FrameSampler
from spikingtac.contact.detector import ContactDetector
from spikingtac.experiments.collision.scene import (
    NEAR_MM,
    RELEASED_S,
    SETTLE_WINDOWS,
    CollisionScene,
    run_up_mm,
    travel_time_s,
)
from spikingtac.robot.approach import ApproachConfig
from spikingtac.robot.arm import ArmState
from spikingtac.sim.rig.rig import WAIT_S, FirstContact, PriorContact, Rig
from spikingtac.sim.rig.ur3 import UR3Twin

Vector = NDArray[np.float64]

RETREAT_MM_S = 180.0
"""Speed of the way back to the start, mm/s: the whole way fits into the second after a release."""
BEYOND_MM = 60.0
"""How far behind the wall the commanded target lies, mm: farther than any method lets it come."""
WINDOW_US = 1000


@dataclass(frozen=True, kw_only=True)
class Watchers:
    """Who watches an approach.

    Attributes:
        detectors: Event detectors by name, fresh.
        frames: The frame sampler, or None.
        enough: Detectors whose decisions end the passage; the others may go without.
        patience_mm: The arm's travel after the touch at which it ends all the same.
    """

    detectors: Mapping[str, ContactDetector]
    frames: FrameSampler | None
    enough: frozenset[str]
    patience_mm: float


@dataclass
class ApproachRun:
    """What happened.

    Attributes:
        touch: The true first touch.
        arm: The arm as it began to move: a clone to be stopped at will.
        decided_us: Method -> time of its first decision.
        costs_us: Detector -> how many windows took how many microseconds of computing.
        counts: Events of each window that was listened to.
        first_us: Beginning of the first of those windows.
    """

    touch: FirstContact
    arm: UR3Twin
    decided_us: dict[str, float] = field(default_factory=dict)
    costs_us: dict[str, Counter[int]] = field(default_factory=dict)
    counts: list[int] = field(default_factory=list)
    first_us: int = 0


def prepare(rig: Rig, scene: CollisionScene, speed_mm_s: float, rng: np.random.Generator) -> None:
    """Touch and let go, go to the start, and wait there until it is time to move.

    The arm begins to move with a cycle of its controller. The start lies up to the way of one cycle
    farther back, at random: from a fixed place every touch would meet the same phase of a cycle.
    """
    released_us = float(rig.t_us)
    if scene.past == "released":
        rig.arm.move_linear(PriorContact().press_mm * scene.direction, PriorContact().speed_mm_s)
        _until_at_rest(rig)
        rig.wait(PriorContact().hold_s)
        rig.arm.move_linear(-NEAR_MM * scene.direction, PriorContact().speed_mm_s)
        while rig.state.in_contact:
            rig.wait(WAIT_S)
        released_us = float(rig.t_us)
        _until_at_rest(rig)
    way_mm = run_up_mm(scene, speed_mm_s) + rng.uniform() * speed_mm_s * scene.rig.arm.cycle_s
    rig.arm.move_linear(-way_mm * scene.direction, RETREAT_MM_S)
    _until_at_rest(rig)
    due_us = released_us + 1e6 * (RELEASED_S - travel_time_s(scene, speed_mm_s, way_mm))
    rig.wait(max((due_us - rig.t_us) * 1e-6, WAIT_S))
    rig.reset_first_contact()


def approach(rig: Rig, scene: CollisionScene, speed_mm_s: float, watchers: Watchers) -> ApproachRun:
    """Move through the wall's place while everybody watches.

    Args:
        rig: Prepared; see :func:`prepare`.
        scene: Its scene.
        speed_mm_s: Speed of the arm.
        watchers: Who watches.
    """
    rig.arm.move_linear(BEYOND_MM * scene.direction, speed_mm_s)
    arm = rig.arm.copy()
    config = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE_WINDOWS)
    before = _cruise(rig, scene, config)
    passage = ApproachRun(FirstContact(float("inf"), np.full(3, np.nan)), arm, first_us=rig.t_us)
    passage.costs_us = {name: Counter() for name in watchers.detectors}
    if watchers.frames is not None:
        watchers.frames.start(np.mean(before, axis=0))
    known = float(rig.t_us), rig.markers_px[0]
    while not _over(rig, watchers, passage):
        window = next(rig.windows())
        passage.counts.append(len(window))
        for name, detector in watchers.detectors.items():
            if name not in passage.decided_us:
                begun = time.perf_counter()
                contact = detector.update(window)
                passage.costs_us[name][round((time.perf_counter() - begun) * 1e6)] += 1
                if contact is not None:
                    passage.decided_us[name] = float(rig.t_us)
        before_us, centers = known
        known = float(rig.t_us), rig.markers_px[0]
        _look(watchers, passage, (np.array([before_us, known[0]]), np.array([centers, known[1]])))
    if rig.first_contact is not None:
        passage.touch = rig.first_contact
    return passage


FRAMES = "frames"
"""Name under which a passage keeps the frame sampler's decision."""


def _look(watchers: Watchers, passage: ApproachRun, truth: tuple[Vector, Vector]) -> None:
    """Show the frame sampler the markers since it last looked."""
    if watchers.frames is not None and FRAMES not in passage.decided_us:
        found = watchers.frames.look(truth)
        if found is not None:
            passage.decided_us[FRAMES] = found


def _cruise(rig: Rig, scene: CollisionScene, config: ApproachConfig) -> list[Vector]:
    """Go on until the arm has cruised long enough; return the markers meanwhile.

    The rule is that of :class:`~spikingtac.robot.approach.Approacher`.
    """
    cruising, seen = 0, []
    while cruising < config.settle_windows:
        next(rig.windows(WINDOW_US))
        speed = float(rig.arm.speed_mm_s() @ scene.direction)
        steady = abs(speed / config.speed_mm_s - 1.0) <= config.cruise_tolerance
        cruising = cruising + 1 if steady else 0
        seen.append(rig.markers_px[0])
    return seen[-config.settle_windows :]


def _over(rig: Rig, watchers: Watchers, passage: ApproachRun) -> bool:
    if rig.first_contact is None:
        return rig.arm.state() is not ArmState.MOVING
    asked = watchers.enough | ({FRAMES} if watchers.frames is not None else set())
    if asked <= set(passage.decided_us):
        return True
    travel = rig.arm.true_position_mm() - rig.first_contact.arm_mm
    return float(np.linalg.norm(travel)) > watchers.patience_mm


def _until_at_rest(rig: Rig) -> None:
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)


@dataclass(frozen=True, slots=True)
class Stopped:
    """What a stop at some instant leads to, mm along the approach from the true first touch.

    Attributes:
        deviation_mm: Where the arm truly was at the decision.
        read_mm: Where the controller said that it was.
        overshoot_mm: Where it truly came to rest.
    """

    deviation_mm: float
    read_mm: float
    overshoot_mm: float


def stop_at(passage: ApproachRun, decided_us: float, direction: Vector) -> Stopped:
    """Return what happens when a method decides at a time, on the passage's own arm."""
    arm, real = passage.arm.copy(), passage.touch.arm_mm
    now_us = round(decided_us)
    arm.advance_to(now_us)
    deviation = float((arm.true_position_mm() - real) @ direction)
    read = float((arm.pose().position_mm - real) @ direction)
    arm.stop()
    while arm.state() is ArmState.MOVING:
        now_us += WINDOW_US
        arm.advance_to(now_us)
    overshoot = float((arm.true_position_mm() - real) @ direction)
    return Stopped(deviation, read, overshoot)
