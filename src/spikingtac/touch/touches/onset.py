"""When a motion began, from the frames that led to it being noticed.

A press starts too softly to be seen in one frame of one marker. So the frames of the last moments
are projected on the pattern that the touch has once it is plain (a matched filter over all
markers), and the first time at which the projection leaves its noise for good is the beginning.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

HISTORY_US = 400_000
"""Frames that are remembered before a touch is noticed, us (ours: the softest press of the ten
scenes takes 60 ms to be noticed)."""
BASE_US = 150_000
"""Span at the start of what is remembered that shows the noise before the touch, us (ours)."""
NOISE_SIGMAS = 4.0
"""Deviations of the projection from its base at which motion is sure (ours)."""
LEAST_SHARE = 0.02
"""Share of the pattern below which no motion is claimed, whatever the noise (ours)."""
GROWTH_POWER = 2.0
"""Power of time with which a press sets in: displacement grows as the square of time from a tool
that accelerates (and as force to the 2/3 in time of a sphere at constant speed, ours: 2)."""


class OnsetMemory:
    """The last frames, thinned to bounded memory, and the search for a beginning in them."""

    def __init__(self) -> None:
        self._frames: deque[tuple[int, Field]] = deque()

    def clear(self) -> None:
        """Forget every frame."""
        self._frames.clear()

    def add(self, t_us: int, displacement: Field) -> None:
        """Remember a frame ``(m, 2)`` and forget those too old."""
        self._frames.append((t_us, displacement))
        while self._frames and t_us - self._frames[0][0] > HISTORY_US:
            self._frames.popleft()

    def begin_us(self, pattern: Field) -> int:
        """Return when the motion towards a pattern ``(m, 2)`` began, us."""
        times = np.array([t for t, _ in self._frames], np.int64)
        fields = np.array([frame for _, frame in self._frames]).reshape(len(times), -1)
        along = fields @ pattern.ravel() / max(float((pattern**2).sum()), 1e-12)
        base = along[times <= max(times[0] + BASE_US, times[0])][: max(len(along) // 2, 1)]
        level, noise = float(np.median(base)), _deviation(base)
        edge = max(NOISE_SIGMAS * noise, LEAST_SHARE)
        above = along - level > edge
        quiet = np.flatnonzero(~above)
        first = int(quiet[-1]) + 1 if len(quiet) else 0
        if first >= len(times):
            return int(times[-1])
        return _extrapolated(times, along - level, first, int(times[0]))


def _extrapolated(times: NDArray[np.int64], along: Field, first: int, earliest_us: int) -> int:
    """Return where the rise from ``first`` on meets zero, by its law of growth."""
    high = int(np.argmax(along[first:] > 4.0 * along[first])) + first
    if high == first or along[first] <= 0.0:
        return int(times[first])
    low_root, high_root = (float(along[i] ** (1.0 / GROWTH_POWER)) for i in (first, high))
    slope = (high_root - low_root) / float(times[high] - times[first])
    back_us = int(low_root / slope)
    return max(int(times[first]) - back_us, earliest_us)


def _deviation(values: Field) -> float:
    """Return a robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
