"""A sequential test over many time scales: is the sum of the last n windows too large for chance?

A motion that begins at an unknown time and runs at an unknown speed shows best in the sum since its
beginning. The generalised likelihood ratio over the time of change is therefore the largest of the
whitened squared sums; testing n = 1, 2, 4, ... loses at most a factor of sqrt(2) in time (Lai,
"Sequential change-point detection in quality control and dynamical systems", J. R. Stat. Soc. B 57,
1995, window-limited rules).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class ScaleTest(NamedTuple):
    """The tests of all time scales, ready to be applied.

    Attributes:
        windows: ``int64[s]`` how many windows each scale sums, increasing.
        whiten: ``(s, d, length)`` maps the votes of a scale to d numbers, each of variance 1 or
            less without contact.
        mean: ``(length,)`` votes per window without contact.
        threshold: ``(s,)`` squared length that calls a contact.
    """

    windows: NDArray[np.int64]
    whiten: Vector
    mean: Vector
    threshold: Vector


class ScaleSums:
    """Keeps the running sums of the votes, and applies the tests to them.

    Args:
        test: The tests.
    """

    def __init__(self, test: ScaleTest) -> None:
        self._test = test
        self._ring = np.zeros((int(test.windows[-1]) + 1, test.whiten.shape[2]))
        self._values = np.zeros(len(test.windows))
        self._seen = 0

    def add(self, votes: Vector) -> Vector:
        """Take the votes of the next window; return the statistic of each scale.

        Scales longer than what was seen since the start have the statistic 0. The array is written
        anew by the next call.
        """
        test = self._test
        self._seen = scales_kernel(
            votes, test.windows, test.whiten, test.mean, self._ring, self._seen, self._values
        )
        return self._values

    def total(self, scale: int) -> Vector:
        """Return the votes ``(length,)`` of the windows that a scale sums now."""
        now = self._seen % len(self._ring)
        start = (self._seen - int(self._test.windows[scale])) % len(self._ring)
        return self._ring[now] - self._ring[start]

    def course(self, along: Vector) -> Vector:
        """Return the running sum along a direction ``(n + 1,)`` over all windows that are kept."""
        kept = min(self._seen, len(self._ring) - 1)
        slots = np.arange(self._seen - kept, self._seen + 1) % len(self._ring)
        return self._ring[slots] @ along

    def reset(self) -> None:
        """Begin anew."""
        self._ring[:] = 0.0
        self._seen = 0


@njit(cache=True)
def scales_kernel(
    votes: Vector,
    windows: NDArray[np.int64],
    whiten: Vector,
    mean: Vector,
    ring: Vector,
    seen: int,
    values: Vector,
) -> int:
    """Add a window to the ring of running sums; write each scale's squared whitened sum.

    Returns:
        How many windows were seen, with this one.
    """
    slots = ring.shape[0]
    before, now = seen % slots, (seen + 1) % slots
    for part in range(len(votes)):
        ring[now, part] = ring[before, part] + votes[part] - mean[part]
    seen += 1
    for scale in range(len(values)):
        values[scale] = 0.0
        if windows[scale] > seen:
            continue
        start = (seen - windows[scale]) % slots
        for row in range(whiten.shape[1]):
            total = 0.0
            for part in range(len(votes)):
                total += whiten[scale, row, part] * (ring[now, part] - ring[start, part])
            values[scale] += total * total
    return seen


@njit(cache=True)
def exceeded_kernel(values: Vector, threshold: Vector) -> int:
    """Return the scale that exceeds its threshold by the largest factor, or -1 for none."""
    best, highest = -1, 1.0
    for scale in range(len(values)):
        ratio = values[scale] / threshold[scale]
        if ratio > highest:
            best, highest = scale, ratio
    return best
