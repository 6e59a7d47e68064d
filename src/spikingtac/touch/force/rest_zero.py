"""The zero of the field: where the markers rest now, learned while nothing presses.

A marker's rest moves from series to series and creeps within one. Frames that lie close to the
zero known so far are taken for rest and move it. A light static touch that moves every marker by
less than the radius cannot be told from rest (docs/explanation/errata.md); it fades into the zero,
and so does a press that moves the markers by less than the radius within the averaging time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]

US_PER_S = 1e6
LONGEST_STEP_S = 0.1
"""Time at rest that one frame stands for, at most, s, however long nothing was seen before it: a
single frame is noise, too (ours: 0.056 s, between two frames of data/force, errs as much)."""


@dataclass(frozen=True, kw_only=True)
class RestZeroConfig:
    """How the zero follows the rests.

    Attributes:
        radius_share: Frames whose rms distance to the zero is below this share of the training
            displacements' rms are rest (ours: 0.06 mm of 0.6 mm on the gel of data/force, whose
            markers scatter by 0.045 mm at rest; 0.075 to 0.1 are alike).
        average_s: Time at rest over which the zero averages, s (ours: 1.7 to 3 are alike).
        prior_s: Weight of the calibrated rest at the start, as time at rest, s (ours: 0.3).
    """

    radius_share: float = 0.1
    average_s: float = 3.0
    prior_s: float = 0.3

    def __post_init__(self) -> None:
        if not (self.radius_share >= 0 and self.average_s > 0 and self.prior_s >= 0):
            raise ValueError("radius_share and prior_s must be >= 0, average_s > 0")


class RestZero:
    """The zero of one series, frame by frame. How often frames come does not matter."""

    def __init__(self, config: RestZeroConfig, radius: float, size: int) -> None:
        """Start at the calibrated rest.

        Args:
            config: How the zero follows.
            radius: Largest rms distance of a rest frame to the zero, in the field's unit.
            size: Numbers in a frame.
        """
        self._config, self._radius = config, radius
        self._rested_s = config.prior_s
        self._last_us: int | None = None
        self.zero = np.zeros(size)

    def subtract(self, t_us: int, displacement: Field) -> Field:
        """Take in the frame ``(size,)`` of a time, us, and return it from the zero."""
        step_s = LONGEST_STEP_S
        if self._last_us is not None:
            step_s = min(max(t_us - self._last_us, 0) / US_PER_S, LONGEST_STEP_S)
        self._last_us = t_us
        rested_s = min(self._rested_s + step_s, self._config.average_s)
        share = step_s / rested_s if rested_s > 0.0 else 0.0
        moved, away = np.ascontiguousarray(displacement, np.float64), np.empty(self.zero.size)
        if rest_kernel(moved, self._radius**2, share, self.zero, away):
            self._rested_s = rested_s
        return away

    def subtract_all(self, t_us: NDArray[np.int64], displacements: Field) -> Field:
        """Take in ``(n, size)`` frames in order and return them from the zero of their time."""
        rows = zip(t_us.tolist(), displacements, strict=True)
        away = [self.subtract(time_us, row) for time_us, row in rows]
        return np.array(away).reshape(displacements.shape)


@njit(cache=True, nogil=True)
def rest_kernel(moved: Field, square: float, share: float, zero: Field, away: Field) -> bool:
    """Fill ``away`` with a frame from its zero, and return whether it is one of rest.

    Args:
        moved: ``(size,)`` the frame.
        square: Mean square of the distance to the zero below which a frame is one of rest.
        share: Share of that distance by which a frame of rest moves the zero.
        zero: ``(size,)`` the zero; moved.
        away: ``(size,)`` overwritten.
    """
    total = 0.0
    for i in range(len(moved)):
        away[i] = moved[i] - zero[i]
        total += away[i] * away[i]
    if not total / len(moved) < square:
        return False
    for i in range(len(moved)):
        zero[i] += share * away[i]
        away[i] = moved[i] - zero[i]
    return True
