"""The features of slip from frame to frame, with a memory of the longest span."""

from __future__ import annotations

from math import log

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.touch.slip.features import (
    FEATURES,
    FIRST_MOTION,
    LEAST_SPEED,
    MOTION_FEATURES,
    MOTION_SPANS_US,
    SIZE,
    SPANS_US,
    SPEEDS,
    WIDTHS,
    field_summary_kernel,
    own_motion_kernel,
    slip_features_kernel,
    spans_kernel,
)

Field = NDArray[np.float64]

# Frames further apart say nothing of slip: the shortest span must hold some, us.
LONGEST_GAP_US = 6_000

# Frames that are remembered at the most: the longest span at 10,000 frames a second.
CAPACITY = 2048
US_PER_S = 1e6

# Change over the longest span, pitches, below which the skin stands still: 0.3 of 37 px (a
# tracker's errors make a third of it, a drag of 2 mm/s makes it in 10 ms).
STILL = 0.008

# Speed over the middle span, as a share of the usual one, below which it stands still, too: 0.03
# px in 40 ms (0.008 to 0.03 are alike; the errors of a tracker make 0.005).
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

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._pitch = marker_pitch_px(reference)
        self._places = np.ascontiguousarray(reference / self._pitch)
        self._spans_us = np.array([*SPANS_US, *MOTION_SPANS_US])
        self._times = np.zeros(CAPACITY, np.int64)
        # Of each frame its summary, then the displacements of its markers, pitches.
        self._rows = np.zeros((CAPACITY, SIZE + reference.size))
        self._before = np.zeros((len(self._spans_us), SIZE + reference.size))
        self.reset()

    def reset(self) -> None:
        """Forget every frame."""
        self._count = 0
        self.still, self.slowing = True, 0.0
        self._starts = np.zeros(len(self._spans_us), np.int64)

    def update(self, t_us: int, displacement: Field) -> Field | None:
        """Take in displacements ``(m, 2)`` from the rest and return their features.

        Returns:
            ``(FEATURES,)``, or None for the first frame and after a gap.
        """
        last_us = self._times[(self._count - 1) % CAPACITY]
        if self._count and not 0 < t_us - last_us <= LONGEST_GAP_US:
            self.reset()
        slot = self._count % CAPACITY
        now, before = self._rows[slot, :SIZE], self._before
        moved = displacement / self._pitch
        field_summary_kernel(self._places, moved, now)
        self._times[slot], self._rows[slot, SIZE:] = t_us, moved.ravel()
        self._count += 1
        if self._count == 1:
            return None
        spans_kernel(self._times, self._rows, self._count, self._spans_us, self._starts, before)
        features, changes = np.empty(FEATURES), len(SPANS_US)
        spans_s = self._spans_us[:changes] / US_PER_S
        slip_features_kernel(now, before[:changes, :SIZE], spans_s, features[:FIRST_MOTION])
        # The latest motions about their own centres.
        parts = features[FIRST_MOTION:].reshape(-1, MOTION_FEATURES)
        for number, start in enumerate(self._starts[changes:].tolist()):
            motion = moved - before[changes + number, SIZE:].reshape(-1, 2)
            elapsed_us = t_us - int(self._times[start % CAPACITY])
            own_motion_kernel(self._places, motion, now, elapsed_us, parts[number])
        # Shifts, growths and turns over the longest span; the centre's place is no motion.
        change = float(((now - before[changes - 1, :SIZE])[:-2] ** 2).sum())
        _, short, middle, long = (float(features[place]) for place in SPEEDS)
        paused = middle < log(PAUSED + LEAST_SPEED)
        self.still = paused or change < len(WIDTHS) * STILL**2
        self.slowing = short - long
        return features
