"""The features of slip from frame to frame, with a memory of the longest span."""

from __future__ import annotations

from math import log

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.slip import own_motion
from spikingtac.touch.slip.features import FEATURES as SUMMARY_FEATURES
from spikingtac.touch.slip.features import (
    LEAST_SPEED,
    SIZE,
    SPANS_US,
    SPEEDS,
    WIDTHS,
    FieldSummary,
    slip_features,
)
from spikingtac.touch.slip.own_motion import SPAN_FEATURES, own_motion_kernel

Field = NDArray[np.float64]

FEATURES = SUMMARY_FEATURES + own_motion.FEATURES  # Number of features of a frame.

# Frames further apart say nothing of slip: the shortest span must hold some (ours).
LONGEST_GAP_US = 6_000

# Frames that are remembered at the most: the longest span at 10,000 frames a second.
CAPACITY = 2048
US_PER_S = 1e6
CENTER_NUMBERS = 2  # Last numbers of a summary: where the field's centre is, which is no motion.

# Change over the longest span, pitches, below which the skin stands still: 0.3 of 37 px (ours: a
# tracker's errors make a third of it, a drag of 2 mm/s makes it in 10 ms).
STILL = 0.008

# Speed over the middle span, as a share of the usual one, below which it stands still, too: 0.03
# px in 40 ms (ours: 0.008 to 0.03 are alike; the errors of a tracker make 0.005).
PAUSED = 0.017


class FeatureStream:
    """Turns displacement fields into features, causally.

    Example:
        >>> axes = np.meshgrid(np.arange(8.0), np.arange(8.0))
        >>> reference = 37.0 * np.column_stack([axis.ravel() for axis in axes])
        >>> stream = FeatureStream(reference)
        >>> stream.update(0, np.zeros((64, 2))) is None  # nothing is known of its change
        True
        >>> stream.update(1_000, np.ones((64, 2))).shape
        (99,)

    Attributes:
        still: Whether the skin stood still over the longest span or, more strictly, the middle one.
        slowing: Logarithm of the field's speed over 10 ms by that over the longest span.
    """

    def __init__(self, reference: Field) -> None:
        """Start without a memory.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.
        """
        self._summary = FieldSummary(reference)
        self._times = np.zeros(CAPACITY, np.int64)
        self._rows = np.zeros((CAPACITY, SIZE))
        self._before = np.zeros((len(SPANS_US), SIZE))
        self._fields = np.zeros((CAPACITY, reference.size))
        self._fields_before = np.zeros((len(own_motion.SPANS_US), reference.size))
        self._own_spans_us = np.array(own_motion.SPANS_US)
        self._spans_us, self._spans = np.array(SPANS_US), np.array(SPANS_US) / US_PER_S
        self.reset()

    def reset(self) -> None:
        """Forget every frame."""
        self._count = 0
        self.still, self.slowing = True, 0.0
        self._starts = np.zeros(len(SPANS_US), np.int64)
        self._own_starts = np.zeros(len(own_motion.SPANS_US), np.int64)

    def update(self, t_us: int, displacement: Field) -> Field | None:
        """Take in displacements ``(m, 2)`` from the rest and return their features.

        Returns:
            ``(FEATURES,)``, or None for the first frame and after a gap.
        """
        last_us = self._times[(self._count - 1) % CAPACITY]
        if self._count and not 0 < t_us - last_us <= LONGEST_GAP_US:
            self.reset()
        now = self._summary.of(displacement)
        slot = self._count % CAPACITY
        self._times[slot], self._rows[slot] = t_us, now
        self._fields[slot] = displacement.ravel() / self._summary.pitch
        self._count += 1
        if self._count == 1:
            return None
        change = spans_kernel(
            self._times, self._rows, self._count, self._spans_us, self._starts, self._before
        )
        features = np.empty(FEATURES)
        features[:SUMMARY_FEATURES] = slip_features(now, self._before, self._spans)
        self._own_motion(now, slot, features[SUMMARY_FEATURES:])
        _, short, middle, long = (float(features[place]) for place in SPEEDS)
        paused = middle < log(PAUSED + LEAST_SPEED)
        self.still = paused or change < len(WIDTHS) * STILL**2
        self.slowing = short - long
        return features

    def _own_motion(self, now: Field, slot: int, out: Field) -> None:
        """Fill the features of the latest motions about their own centres."""
        spans_us, starts, before = self._own_spans_us, self._own_starts, self._fields_before
        spans_kernel(self._times, self._fields, self._count, spans_us, starts, before)
        moved, summary = self._fields[slot], self._summary
        for number, start in enumerate(starts.tolist()):
            motion = (moved - before[number]).reshape(-1, 2)
            elapsed_us = int(self._times[slot] - self._times[start % CAPACITY])
            own = out[number * SPAN_FEATURES : (number + 1) * SPAN_FEATURES]
            own_motion_kernel(summary.places, summary.decay, motion, now, elapsed_us, own)


@njit(cache=True, nogil=True)
def spans_kernel(
    times_us: NDArray[np.int64],
    rows: Field,
    count: int,
    spans_us: NDArray[np.int64],
    starts: NDArray[np.int64],
    before: Field,
) -> float:
    """Fill the rows at the beginnings of the spans; return the square of the last's change.

    Args:
        times_us: ``(c,)`` times of the frames, us; frame k lies in slot k modulo c.
        rows: ``(c, n)`` what is kept of each: its summary, or the whole field.
        count: Frames so far.
        spans_us: ``(s,)`` spans up to the last frame, us, from short to long.
        starts: ``(s,)`` number of the frame at which each began before; moved on to the last one
            at or before its beginning, or to the first that is remembered.
        before: ``(s, n)`` overwritten.
    """
    capacity = len(times_us)
    now = (count - 1) % capacity
    for number in range(len(spans_us)):
        start = max(starts[number], count - capacity)
        begin_us = times_us[now] - spans_us[number]
        while start + 1 < count and times_us[(start + 1) % capacity] <= begin_us:
            start += 1
        starts[number] = start
        for k in range(rows.shape[1]):
            before[number, k] = rows[start % capacity, k]
    square = 0.0
    for k in range(rows.shape[1] - CENTER_NUMBERS):
        square += (rows[now, k] - before[-1, k]) ** 2
    return square
