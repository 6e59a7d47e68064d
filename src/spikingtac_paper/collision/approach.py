"""One approach through the whole twin that does not stop at contact; every method observes it.

The arm is position-controlled. The outcome of a method therefore follows from the time of its
decision: a copy of the arm is stopped at that time. A test compares this with the closed loop
(:func:`~spikingtac.robot.approacher.approach`): decision and overshoot are the same.

The frame-based baseline is the published displacement sum at 32 fps (section V-B),
``D(t) = sum_i |p_i(t) - p_i,init|``. Contact is detected where it exceeds the upper bound of an
interval without contact. Frames are not simulated: the true centres of the markers replace the
measurement of a camera with a global shutter and without exposure time, plus a declared measurement
noise. This favours the baseline.
"""

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from spikingtac.contact import WINDOW_US, ContactDetector
from spikingtac.robot import CRUISE_TOLERANCE, ApproachConfig, ArmState
from spikingtac.sim import FirstContact, Rig, UR3Twin
from spikingtac.types import FloatArray
from spikingtac_paper.collision.scene import (
    DIRECTION,
    NEAR_MM,
    PRIOR_TOUCH,
    RELEASED_S,
    SETTLE_WINDOWS,
    run_up_mm,
    travel_time_s,
)
from spikingtac_paper.trials.trajectories import places_at

RATE_HZ = 32.0  # Frames per second (section V-B of the paper, on GelStereo 2.0).
PERIOD_US = 1e6 / RATE_HZ  # Time between two frames, us.

# Standard deviation of a measured centre per axis, px (assumed: centroids of dots a dozen pixels
# wide reach 0.02 to 0.1 px in frames; see the assumptions).
NOISE_PX = 0.1
FIRST_FRAMES = 3  # Number of frames whose mean gives the initial coordinates.

# False-alarm budget of the threshold, the same as that of the event detectors.
FALSE_ALARMS_PER_HOUR = 1.0
SECONDS_PER_HOUR = 3600.0

# Smallest number of frames without contact: fewer do not give a standard deviation to 10 %.
MIN_FRAMES = 50
Truth = tuple[FloatArray, FloatArray]  # Times ``(k,)``, us, and true centres ``(k, m, 2)``, px.


def displacement_sum_px(frames_px: FloatArray, initial_px: FloatArray) -> FloatArray:
    """Return the published ``D(t)`` ``(n,)`` of frames ``(n, m, 2)``, px."""
    away = frames_px - initial_px
    return np.hypot(away[:, :, 0], away[:, :, 1]).sum(axis=1)


def exposures_us(phase: float, from_us: int, to_us: int) -> FloatArray:
    """Return the times of the frames in ``[from_us, to_us)``, us.

    Args:
        phase: Phase of the first frame after time zero, as a fraction of a period, 0 to 1.
        from_us: Start, us.
        to_us: End, us.
    """
    first = math.ceil(from_us / PERIOD_US - phase)
    last = math.ceil(to_us / PERIOD_US - phase)
    return np.asarray((np.arange(first, last) + phase) * PERIOD_US, np.float64)


def measured_px(times_us: FloatArray, truth: Truth, rng: np.random.Generator) -> FloatArray:
    """Return the measured centres ``(n, m, 2)`` in frames, px.

    Args:
        times_us: ``(n,)`` exposures, us.
        truth: The true centres, which are interpolated.
        rng: Source of the measurement noise.
    """
    exact = places_at(times_us, *truth)
    return exact + rng.normal(0.0, NOISE_PX, exact.shape)


def quiet_threshold_px(sums_px: Sequence[float] | FloatArray) -> float:
    """Return the upper bound of the displacement sum without contact, px.

    It is the highest sum in the frames, or the normal tail at the budget if that is higher: the
    highest sum of one minute alone would be exceeded about once a minute.

    Args:
        sums_px: ``(n,)`` displacement sums without contact, px.

    Raises:
        ValueError: There are fewer than :data:`MIN_FRAMES` frames.
    """
    sums = np.asarray(sums_px, np.float64)
    if len(sums) < MIN_FRAMES:
        raise ValueError(f"{len(sums)} quiet frames are too few, at least {MIN_FRAMES} are needed")
    chance = FALSE_ALARMS_PER_HOUR / (RATE_HZ * SECONDS_PER_HOUR)
    tail = sums.mean() + float(norm.isf(chance)) * sums.std(ddof=1)
    return float(max(sums.max(), tail))


class FrameSampler:
    """Evaluates frames in order and returns the first one that shows contact.

    Args:
        threshold_px: Threshold of the displacement sum, px.
        phase: Phase of its frames, as a fraction of a period.
        rng: Source of the measurement noise.
    """

    def __init__(self, threshold_px: float, phase: float, rng: np.random.Generator) -> None:
        self._threshold, self._phase, self._rng = threshold_px, phase, rng
        self._initial = np.empty(0)

    def start(self, centers_px: FloatArray) -> None:
        """Set the initial coordinates ``(m, 2)``, px: a mean over some frames without contact."""
        spread = NOISE_PX / math.sqrt(FIRST_FRAMES)
        self._initial = centers_px + self._rng.normal(0.0, spread, centers_px.shape)

    def look(self, truth: Truth) -> float | None:
        """Return the exposure at which contact shows, us, or None.

        Args:
            truth: The true centres; give each stretch of time once.
        """
        times = exposures_us(self._phase, int(truth[0][0]), int(truth[0][-1]))
        if not len(times):
            return None
        sums = displacement_sum_px(measured_px(times, truth, self._rng), self._initial)
        beyond = np.flatnonzero(sums > self._threshold)
        return float(times[beyond[0]]) if len(beyond) else None


# Speed of the motion back to the start, mm/s: it ends within the second after a release.
RETREAT_MM_S = 180.0
WAIT_S = 0.001  # Period at which a waiting loop checks its condition, s.
BEYOND_MM = 60.0  # Distance of the commanded target behind the wall, mm: no method stops that late.
FRAMES = "frames"  # Name of the frame sampler's decision in :attr:`ApproachRun.decided_us`.


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
    rig.first_contact = None


def approach(
    rig: Rig,
    speed_mm_s: float,
    detectors: Mapping[str, ContactDetector],
    frames: FrameSampler | None,
    required: frozenset[str],
    patience_mm: float,
) -> ApproachRun:
    """Move the arm past the wall's place while all methods observe.

    Args:
        rig: The rig after :func:`prepare`.
        speed_mm_s: Speed of the arm, mm/s.
        detectors: Event detectors by name, reset.
        frames: The frame sampler, or None.
        required: Detectors whose decisions end the run; it does not wait for the others.
        patience_mm: Travel of the arm after the touch at which the run ends in any case, mm.
    """
    rig.arm.move_linear(BEYOND_MM * DIRECTION, speed_mm_s)
    arm = copy(rig.arm)
    config = ApproachConfig(speed_mm_s=speed_mm_s, settle_windows=SETTLE_WINDOWS)
    before = _cruise(rig, config)
    run = ApproachRun(FirstContact(float("inf"), np.full(3, np.nan)), arm)
    run.costs_us = {name: Counter() for name in detectors}
    if frames is not None:
        frames.start(np.mean(before, axis=0))
        required = required | {FRAMES}
    known = float(rig.t_us), rig.image.center_px
    while not _has_ended(rig, required <= run.decided_us.keys(), patience_mm):
        window = next(rig.windows())
        for name, detector in detectors.items():
            if name not in run.decided_us:
                begun = time.perf_counter()
                contact = detector.update(window)
                run.costs_us[name][round((time.perf_counter() - begun) * 1e6)] += 1
                if contact is not None:
                    run.decided_us[name] = float(rig.t_us)
        before, known = known, (float(rig.t_us), rig.image.center_px)
        if frames is not None and FRAMES not in run.decided_us:
            times_us, centers = (np.array(column) for column in zip(before, known, strict=True))
            found = frames.look((times_us, centers))
            if found is not None:
                run.decided_us[FRAMES] = found
    if rig.first_contact is not None:
        run.touch = rig.first_contact
    return run


def _cruise(rig: Rig, config: ApproachConfig) -> list[FloatArray]:
    """Wait until the arm has cruised for ``settle_windows``; return the markers of these windows.

    The rule is that of :func:`~spikingtac.robot.approacher.approach`.
    """
    cruising, seen = 0, []
    while cruising < config.settle_windows:
        next(rig.windows())
        speed = float(rig.arm.speed_mm_s() @ DIRECTION)
        steady = abs(speed / config.speed_mm_s - 1.0) <= CRUISE_TOLERANCE
        cruising = cruising + 1 if steady else 0
        seen.append(rig.image.center_px)
    return seen[-config.settle_windows :]


def _has_ended(rig: Rig, all_decided: bool, patience_mm: float) -> bool:
    if rig.first_contact is None:
        return rig.arm.state() is not ArmState.MOVING
    travel = rig.arm.true_position_mm() - rig.first_contact.arm_mm
    return all_decided or float(np.linalg.norm(travel)) > patience_mm


def _until_at_rest(rig: Rig) -> None:
    while rig.arm.state() is ArmState.MOVING:
        rig.wait(WAIT_S)


def stop_at(run: ApproachRun, decided_us: float) -> dict[str, float]:
    """Return where the arm is at a decision, truly and as it reports, and where it comes to rest.

    A copy of the run's arm is stopped. Positions are along the approach, mm from the true first
    touch; ``delay_us`` is the time from there.
    """
    arm, real = copy(run.arm), run.touch.arm_mm
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
