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
        whiten: ``(s, d, length)`` maps the evidence of a scale to d numbers, each of variance 1 or
            less without contact.
        mean: ``(length,)`` evidence per window without contact.
        threshold: ``(s,)`` squared length that calls a contact.
    """

    windows: NDArray[np.int64]
    whiten: Vector
    mean: Vector
    threshold: Vector


class ScaleSums:
    """Keeps running sums of the evidence, and applies the tests to them.

    Args:
        test: The tests.
    """

    def __init__(self, test: ScaleTest) -> None:
        self._test = test
        self._ring = np.zeros((int(test.windows[-1]) + 1, test.whiten.shape[2]))
        self._values = np.zeros(len(test.windows))
        self._seen = 0

    def add(self, evidence: Vector) -> Vector:
        """Take the evidence of the next window; return the statistic of each scale.

        Scales longer than the time since the start have the statistic 0. The next call overwrites
        the array.
        """
        test = self._test
        self._seen = scales_kernel(
            evidence, test.windows, test.whiten, test.mean, self._ring, self._seen, self._values
        )
        return self._values

    def total(self, scale: int) -> Vector:
        """Return the evidence ``(length,)`` of the windows that a scale sums now."""
        now = self._seen % len(self._ring)
        start = (self._seen - int(self._test.windows[scale])) % len(self._ring)
        return self._ring[now] - self._ring[start]

    def course(self, along: Vector) -> Vector:
        """Return the running sum along a direction ``(n + 1,)`` over all kept windows."""
        kept = min(self._seen, len(self._ring) - 1)
        slots = np.arange(self._seen - kept, self._seen + 1) % len(self._ring)
        return self._ring[slots] @ along

    def reset(self) -> None:
        """Forget all sums."""
        self._ring[:] = 0.0
        self._seen = 0


@njit(cache=True)
def scales_kernel(
    evidence: Vector,
    windows: NDArray[np.int64],
    whiten: Vector,
    mean: Vector,
    ring: Vector,
    seen: int,
    values: Vector,
) -> int:
    """Add a window to the ring of running sums; write each scale's squared whitened sum.

    Returns:
        The number of windows so far, this one included.
    """
    slots = ring.shape[0]
    before, now = seen % slots, (seen + 1) % slots
    for part in range(len(evidence)):
        ring[now, part] = ring[before, part] + evidence[part] - mean[part]
    seen += 1
    for scale in range(len(values)):
        values[scale] = 0.0
        if windows[scale] > seen:
            continue
        start = (seen - windows[scale]) % slots
        for row in range(whiten.shape[1]):
            total = 0.0
            for part in range(len(evidence)):
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
