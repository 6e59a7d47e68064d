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
"""Frames that are remembered before a touch is noticed, us (ours: presses of the ten scenes are
noticed after 15 to 60 ms)."""
RISEN_SHARE = 0.25
"""Share of the pattern at which a rise is under way: what lies well before is rest (ours)."""
BASE_US = 150_000
"""Span of rest that shows drift and noise, us (ours)."""
LEAST_GAP_US = 10_000
"""Time between the rest and the rise that is looked at for neither, at the least, us (ours)."""
NOISE_SIGMAS = 4.0
"""Deviations from the drift of the rest at which motion is sure (ours)."""
LEAST_SHARE = 0.01
"""Share of the pattern below which no motion is claimed, whatever the noise (ours)."""
GROWTH_POWER = 2.0
"""Power of time with which a press is taken to set in (a sphere at constant speed has 1.5, Hertz;
a tool that gathers speed up to 3). Ours: fitting the power to each touch errs more."""


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
        along = along - along[-1] + 1.0
        risen = np.flatnonzero(along < RISEN_SHARE)
        if not len(risen):
            return int(times[-1])
        rest = _rest_rows(times, int(times[risen[-1]]))
        level = _line(times[rest], along[rest], times)
        above = along - level
        edge = max(NOISE_SIGMAS * _deviation(above[rest]), LEAST_SHARE)
        quiet = np.flatnonzero(above <= edge)
        first = min(int(quiet[-1]) + 1, len(times) - 1) if len(quiet) else 0
        return _extrapolated(times, above, first)


def _rest_rows(times: NDArray[np.int64], risen_us: int) -> slice:
    """Return the rows of rest before a rise that is a quarter done at ``risen_us``."""
    rise_us = int(times[-1]) - risen_us
    until_us = risen_us - max(2 * rise_us, LEAST_GAP_US)
    first, last = np.searchsorted(times, [until_us - BASE_US, until_us])
    return slice(int(first), max(int(last), int(first) + 1, 3))


def _line(times: NDArray[np.int64], values: Field, at: NDArray[np.int64]) -> Field:
    """Return the drift of the rest at other times: its slope only where the rest is long enough."""
    center = float(np.median(times))
    level = float(np.median(values))
    half = len(values) // 2
    if times[-1] - times[0] < BASE_US // 2:
        return np.full(len(at), level)
    early, late = float(np.median(values[:half])), float(np.median(values[half:]))
    slope = (late - early) / (float(np.median(times[half:])) - float(np.median(times[:half])))
    return level + slope * (at.astype(np.float64) - center)


def _extrapolated(times: NDArray[np.int64], above: Field, first: int) -> int:
    """Return where the rise from ``first`` on meets its rest, by its law of growth."""
    steep = np.flatnonzero(above[first:] > 4.0 * above[first])
    if not len(steep) or above[first] <= 0.0:
        return int(times[first])
    high = first + int(steep[0])
    low_root, high_root = (float(above[i] ** (1.0 / GROWTH_POWER)) for i in (first, high))
    slope = (high_root - low_root) / float(times[high] - times[first])
    return max(int(times[first]) - int(low_root / slope), int(times[0]))


def _deviation(values: Field) -> float:
    """Return a robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
