"""Displacement fields from the skin's present rest, with a short memory of what was before.

A marker's rest moves from day to day and creeps. Frames close to the zero known so far are taken
for rest and move it, so the zero of displacement and force is removed wherever nothing touches. A
light static touch that moves all markers by less than the radius fades into the zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

US_PER_S = 1e6

# Rms distance to the zero below which a frame is one of rest, over the rms of the displacements
# that were learned (ours: 0.06 mm of 0.6 mm; markers of data/force scatter by 0.045 mm at rest).
RADIUS_SHARE = 0.1

# Time at rest over which the zero averages, and the weight of the calibrated rest, s (ours).
AVERAGE_S, PRIOR_S = 3.0, 0.3

# Time at rest that one frame stands for at most, s: a single frame is noise, too (ours).
LONGEST_STEP_S = 0.1

# What a field gains from its own past: shares of its means over two times, s. A gel that has just
# been pressed gives way: the same force moves it less far than the tared field says (ours: R2 of
# the normal force between the series of data/force 0.89 instead of 0.86; 0.02 to 8 s were tried).
# Other gels do not: the fit decides whether there is a memory.
MEMORY_SHARES, MEMORY_S = np.array([[0.15], [0.3]]), np.array([[0.3], [5.0]])

# Frames farther apart, s, tell nothing of what was between: the memory fades as at rest.
LONGEST_GAP_S = 0.2


class FieldStream:
    """One series, frame by frame. How often frames come does not matter."""

    def __init__(self, radius: float, size: int, memory: bool) -> None:
        """Start at the calibrated rest.

        Args:
            radius: Largest rms distance of a rest frame to the zero, in the fields' unit.
            size: Numbers in a frame.
            memory: Whether fields gain from their past.
        """
        self._radius, self._size, self._memory = radius, size, memory
        self.reset()

    def reset(self) -> None:
        """Return to the calibrated rest."""
        self._zero = np.zeros(self._size)
        self._means = np.zeros((len(MEMORY_S), self._size))
        self._rested_s = PRIOR_S
        self._last_us: int | None = None

    def tare(self, displacement: Field) -> None:
        """Take a frame ``(size,)`` for the rest."""
        self._zero = displacement.copy()
        self._means[:] = 0.0
        self._rested_s = AVERAGE_S

    def update(self, t_us: int, displacement: Field) -> Field:
        """Take in the frame ``(size,)`` of a time, us, and return it from the zero."""
        first = self._last_us is None
        elapsed_s = 0.0 if self._last_us is None else max(t_us - self._last_us, 0) / US_PER_S
        self._last_us = t_us
        away = displacement - self._zero
        if away @ away < self._radius**2 * self._size:
            step_s = LONGEST_STEP_S if first else min(elapsed_s, LONGEST_STEP_S)
            self._rested_s = min(self._rested_s + step_s, AVERAGE_S)
            self._zero = self._zero + step_s / self._rested_s * away
            away = displacement - self._zero
        return self._with_memory(elapsed_s, away) if self._memory else away

    def _with_memory(self, elapsed_s: float, away: Field) -> Field:
        """Solve e = u + sum of c_i ((1 - g_i) m_i + g_i e) for e; the means m_i follow it."""
        fade = -np.expm1(-elapsed_s / MEMORY_S)
        if elapsed_s > LONGEST_GAP_S:
            self._means *= 1.0 - fade
            fade = np.zeros_like(fade)
        kept = (MEMORY_SHARES * (1.0 - fade) * self._means).sum(axis=0)
        told = (away + kept) / (1.0 - float((MEMORY_SHARES * fade).sum()))
        self._means += fade * (told - self._means)
        return told


def fields_of(t_us: NDArray[np.int64], displacement: Field, radius: float, memory: bool) -> Field:
    """Return the fields ``(n, size)`` of a series of displacements ``(n, m, d)``."""
    flat = displacement.reshape(len(t_us), -1)
    stream = FieldStream(radius, flat.shape[1], memory)
    rows = [stream.update(time_us, row) for time_us, row in zip(t_us.tolist(), flat, strict=True)]
    return np.array(rows).reshape(flat.shape)
