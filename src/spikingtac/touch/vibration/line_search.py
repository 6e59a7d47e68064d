"""The strongest line in the spectrum of a velocity, distinguished from the noise around it.

A Hann window keeps a line within three bins; its frequency between bins follows from the logarithms
of their amplitudes (F. J. Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66,
1978). The noise is the median of the neighbours on the louder side, so that neither a white floor
nor the slope that the slow motion of a touch leaves passes for a line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]

LINE_BINS = 3
"""Bins on both sides of a line that it may fill itself."""
TINY = 1e-30


@dataclass(frozen=True, slots=True)
class Band:
    """Where lines are looked for.

    Attributes:
        lowest_hz: Lowest frequency, Hz.
        highest_hz: Highest, Hz.
        ratio: Amplitude over the median of the neighbours from which on a line is none of noise.
        neighbours: Bins on both sides that tell the noise.
    """

    lowest_hz: float
    highest_hz: float
    ratio: float
    neighbours: int


def strongest_line(velocity: Field, rate_hz: float, band: Band) -> tuple[float, float] | None:
    """Return frequency, Hz, and ratio to the noise of the strongest line, or None.

    Args:
        velocity: ``(n, 2)`` samples, in any unit.
        rate_hz: Samples per second.
        band: Where lines are looked for.
    """
    window = np.hanning(len(velocity) + 1)[:-1]
    spectrum = np.fft.rfft((velocity - velocity.mean(axis=0)) * window[:, None], axis=0)
    power = (np.abs(spectrum) ** 2).sum(axis=1) + TINY
    bin_hz = rate_hz / len(velocity)
    first = max(2, int(np.ceil(band.lowest_hz / bin_hz)))
    last = min(len(power) - 2, int(band.highest_hz / bin_hz))
    ratio = np.sqrt(power[first : last + 1] / _floor(power, first, last, band.neighbours))
    here = power[first : last + 1]
    peaks = (here > power[first - 1 : last]) & (here > power[first + 1 : last + 2])
    candidates = np.where(peaks & (ratio > band.ratio), here, 0.0)
    best = int(candidates.argmax())
    if candidates[best] == 0.0:
        return None
    left, top, right = 0.5 * np.log(power[first + best - 1 : first + best + 2])
    bend = left - 2.0 * top + right
    shift = 0.5 * float(left - right) / float(bend) if bend < 0.0 else 0.0
    return (first + best + float(np.clip(shift, -0.5, 0.5))) * bin_hz, float(ratio[best])


def _floor(power: Field, first: int, last: int, neighbours: int) -> Field:
    """Return the noise in the bins from ``first`` to ``last``: the louder side's median power."""
    away = np.arange(LINE_BINS + 1, LINE_BINS + 1 + neighbours)
    sides = []
    for sign in (-1, 1):
        columns = np.arange(first, last + 1)[:, None] + sign * away
        inside = (columns >= 1) & (columns < len(power))
        values = np.where(inside, power[np.clip(columns, 1, len(power) - 1)], np.inf)
        ordered = np.sort(values, axis=1)  # those outside come last
        middle = np.maximum(inside.sum(axis=1) - 1, 0) // 2
        found = ordered[np.arange(len(ordered)), middle]
        sides.append(np.where(inside.any(axis=1), found, 0.0))
    return np.maximum(*sides)
