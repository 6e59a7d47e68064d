"""One touch, what is measured at its peak, and when it is over.

A recording that begins touched takes the touched skin for its rest, since a gel that has crept
looks alike. Its release then looks like a touch, and one that never ends.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from spikingtac.touch.field import FieldQuantities, GradientOperator, spread_of
from spikingtac.types import FloatArray, one_line


@dataclass(frozen=True, slots=True)
class Touch:
    """A touch from its first motion to its release.

    Lengths are in the unit of the detector's markers: px, or mm where it was set to that.

    Attributes:
        begin_us: When the skin began to move, us.
        end_us: When the skin was released, us; None where the recording ended first.
        peak_us: When the skin was deformed most, us.
        peak_strength: Strength of the displacement's gradient then (1 is 100 % strain).
        peak_displacement_px: Largest displacement of a marker over the touch, px.
        place_px: ``(2,)`` centre of the contact patch at the peak, px.
        area_px2: Area of that patch, px squared.
        outline_px: ``(k, 2)`` its convex outline, px.
        field: Shear, torsion, divergence, curl and strain of the whole field at the peak, with the
            deviations of markers that scatter as the detector expects.
    """

    begin_us: int
    end_us: int | None
    peak_us: int
    peak_strength: float
    peak_displacement_px: float
    place_px: FloatArray
    area_px2: float
    outline_px: FloatArray
    field: FieldQuantities

    __repr__ = one_line

    @property
    def duration_us(self) -> int | None:
        """Time from begin to end, us; None where the end was not seen."""
        return None if self.end_us is None else self.end_us - self.begin_us


# A touch moves so many markers, against the median of all, by this share of the one that moves
# most: skin moves about its place. Less is noise in single markers.
SUPPORT_MARKERS, SUPPORT_SHARE = 3, 0.15


def spreads(away: FloatArray) -> bool:
    """Return whether displacements ``(m, 2)`` are more than a fault of one or two markers."""
    markers = len(away)
    if markers <= 2 * SUPPORT_MARKERS:
        return True
    _, most = spread_of(away, (markers - 0.5) / markers)
    _, least = spread_of(away, (markers - SUPPORT_MARKERS + 0.5) / markers)
    return least >= SUPPORT_SHARE * most


# Share of the peak strength below which the skin is released (residues lie below 0.18 and touches
# above 0.28 on the ten scenes).
END_SHARE = 0.22

# Share of that by which a release that is over may still fall, and the time over which, us.
FLAT_SHARE, FLAT_US = 0.1, 20_000

# Share of the peak strength by which a skin that stands still may change.
STILL_SLACK = 0.02

# Time for which a skin below :data:`STILL_SHARE` must stand still to have been released when it
# began to stand, us. Pixels that recover let it fall further later.
STOOD_US = 50_000

# Longest time that they take for that (143 and 187 ms on a recorded gel; a comb that is
# slid on the twin stands below that share for 250).
RECOVERED_US = 200_000

# Share of the peak strength below which the skin is released where it also stands still: a
# tracker of a sensor with rare OFF events keeps some of it (0.26 on a recorded gel; holds
# of the ten scenes lie above 0.3).
STILL_SHARE = 0.3
STILL_US = 400_000  # Time for which it must stand still for that, us.

# Time below that share that is needed, us (a shake of 12 Hz passes through its rest for 5
# ms).
END_HOLD_US = 40_000
RELEASE_US = 150_000  # Longest time that a release may take from there on, us.


class Release:
    """Watches one touch for its release, causally."""

    def __init__(self) -> None:
        self._still_us, self._still_left = 0, 1.0
        self._stood_us: int | None = None
        self._fell_us: int | None = None
        self._falling: deque[tuple[int, float]] = deque()

    def update(self, t_us: int, left: float) -> int | None:
        """Take in the share of the peak that is left; return when the touch ended, or None."""
        if abs(left - self._still_left) > STILL_SLACK:
            self._still_us, self._still_left = t_us, left
        if left > STILL_SHARE:
            self._stood_us = None
        elif self._stood_us is None and t_us - self._still_us >= STOOD_US:
            self._stood_us = self._still_us
        end_us = self._ended_us(t_us, left)
        if end_us is None or self._stood_us is None or end_us - self._stood_us > RECOVERED_US:
            return end_us
        return min(end_us, self._stood_us)

    def _ended_us(self, t_us: int, left: float) -> int | None:
        """Return when it ended, or None: below its share, for long enough, and flat."""
        if left > END_SHARE:
            self._fell_us = None
            self._falling.clear()
            still = left < STILL_SHARE and t_us - self._still_us >= STILL_US
            return self._still_us if still else None
        if self._fell_us is None:
            self._fell_us = t_us
        self._falling.append((t_us, left))
        if t_us - self._fell_us < END_HOLD_US:
            return None
        while t_us - self._falling[0][0] > RELEASE_US:
            self._falling.popleft()
        if (flat_us := self._flat_since_us()) is not None:
            return flat_us
        return t_us if t_us - self._fell_us >= RELEASE_US else None

    def _flat_since_us(self) -> int | None:
        """Return the first time from which the strength hardly fell any more, or None."""
        times, left = np.array(self._falling).T
        later = np.searchsorted(times, times + FLAT_US)
        known = later < len(times)
        flat = np.flatnonzero(left[known] - left[later[known]] < FLAT_SHARE * END_SHARE)
        return int(times[flat[0]]) if len(flat) else None


# Times the strength of the rest from which it began that a touch must reach which began towards
# the calibrated rest; what is weaker was the way there (that way by itself reaches one).
RETURN_FACTOR = 1.5


class CalibratedRest:
    """Watches an open touch for the skin's return to where it was calibrated, causally."""

    def __init__(self, gradient: GradientOperator, zero: FloatArray, pattern: FloatArray) -> None:
        """Start where a touch begins.

        Args:
            gradient: Of these markers.
            zero: ``(m, 2)`` rest from which it begins, from the calibrated one, px.
            pattern: ``(m, 2)`` of the touch from there, px.
        """
        self._gradient = gradient
        self._off, threshold = gradient.strength_of(zero), gradient.strength_of(pattern)
        self._limit = max(threshold, END_SHARE * self._off)
        self._apart = self._off > threshold
        self._towards = bool((pattern * zero).sum() < 0.0)
        self._back_us: int | None = None

    def update(self, t_us: int, moved: FloatArray) -> int | None:
        """Take in displacements ``(m, 2)``, px; return since when the skin is back, us.

        Returns:
            That, once it has been back for long; None before, and where it began there.
        """
        if not self._apart:
            return None
        if self._gradient.strength_of(moved) > self._limit:
            self._back_us = None
            return None
        self._back_us = t_us if self._back_us is None else self._back_us
        return self._back_us if t_us - self._back_us >= STILL_US else None

    def was_return(self, peak: float) -> bool:
        """Return whether a touch of this peak was the way back only: the skin is back now."""
        return self._back_us is not None and self._towards and peak < RETURN_FACTOR * self._off


@dataclass(slots=True)
class OpenTouch:
    """A touch that is not over yet, and the most of it so far.

    Attributes:
        begin_us: When the skin began to move, us.
        threshold: Strength of the gradient at which it began.
        release: Watches for its end.
        home: Watches for the return to the calibrated rest.
        field: ``(m, 2)`` displacements where the skin is deformed most, px.
        strength: Strength of their gradient.
        peak_us: When that was, us.
        largest_px: Largest displacement of a marker, whenever it was, px.
        spread: Largest displacement that most of the markers reach, whenever it was, px.
        spreads: Whether at the peak more markers moved than a fault of one or two explains.
    """

    begin_us: int
    threshold: float
    release: Release
    home: CalibratedRest
    field: FloatArray
    strength: float = 0.0
    peak_us: int = 0
    largest_px: float = 0.0
    spread: float = 0.0
    spreads: bool = True
