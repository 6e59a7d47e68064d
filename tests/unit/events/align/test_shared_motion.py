"""Two sensors that feel the same taps: their clocks are found from the events alone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.events.align.shared_motion import Course, course_of, through_motion
from spikingtac.events.clock import TimeMap
from spikingtac.types import EventPacket

LENGTH_S = 60.0


def taps(seed: int, count: int = 25) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).uniform(1.0, LENGTH_S - 1.0, count)) * 1e6


def course(moments_us: np.ndarray, seed: int, loud: float) -> Course:
    """Noise, and a burst that decays within 30 ms at every moment, another strength for each."""
    rng = np.random.default_rng(seed)
    first_us = int(moments_us[0]) - 500_000
    grid_us = first_us + np.arange(0, int(moments_us[-1]) + 500_000 - first_us, 1_000)
    rate = np.full(len(grid_us), 4.0)
    for moment_us in moments_us:
        since_ms = (grid_us + 500 - moment_us) / 1e3
        strength = loud * rng.uniform(0.3, 1.0)
        rate += strength * np.where(since_ms > 0, np.exp(-np.maximum(since_ms, 0.0) / 30.0), 0.0)
    return Course(first_us, rng.poisson(rate).astype(float))


@pytest.mark.parametrize(
    ("drift_ppm", "shift_us"), [(0.0, 0), (80.0, 3_210_400), (-50.0, -777_300)]
)
def test_the_map_is_found_within_its_error(drift_ppm: float, shift_us: int) -> None:
    base_us = taps(1)
    truth = TimeMap(base_us=float(shift_us), drift_ppm=drift_ppm)
    own_us = truth.inverse()(base_us.astype(np.int64)).astype(float)
    found = through_motion(course(own_us, 2, 300.0), course(base_us, 3, 90.0))
    assert found.learned_from == "motion"
    assert found.drift_error_ppm is not None
    assert abs(found.drift_ppm - drift_ppm) < 5.0 * found.drift_error_ppm
    middle = np.array([round(found.own_us)])
    assert abs(found(middle)[0] - truth(middle)[0]) < 5.0 * found.error_us
    assert found.error_us < 500.0
    assert found.drift_error_ppm < 20.0


def test_other_touches_are_refused() -> None:
    with pytest.raises(RecordingError, match="agree by"):
        through_motion(course(taps(1), 2, 300.0), course(taps(9), 3, 300.0))


def test_touches_that_repeat_alike_are_refused() -> None:
    regular_us = np.arange(1.0, LENGTH_S, 1.5) * 1e6
    with pytest.raises(RecordingError, match="several places"):
        through_motion(course(regular_us, 2, 300.0), course(regular_us, 3, 300.0))


def test_events_are_counted_by_the_millisecond_over_any_packets() -> None:
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(5_300, 90_000_000, 5_000)).astype(np.int64)
    zero = np.zeros(len(t), np.uint16)
    whole = EventPacket(zero, zero, zero > 0, t, 0, int(t[-1]) + 1, (4, 4), True)
    cuts = [0, 1, 17, 2_000, 2_000, 5_000]
    pieces = [whole.part(a, b, 0, 1) for a, b in itertools.pairwise(cuts)]
    found = course_of(pieces)
    assert found.t_first_us == t[0]
    expected = np.bincount((t - t[0]) // 1_000)
    np.testing.assert_array_equal(found.stir, expected)
    with pytest.raises(RecordingError, match="without events"):
        course_of([EventPacket.empty(0, 5, (4, 4))])
