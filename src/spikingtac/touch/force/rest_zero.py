"""The zero of the field: where the markers rest now, learned while nothing presses.

A marker's rest moves from series to series and creeps within one. Frames that lie close to the
zero known so far are taken for rest and move it. A light static touch that moves every marker by
less than the radius cannot be told from rest (docs/explanation/errata.md); it fades into the zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RestZeroConfig:
    """How the zero follows the rests.

    Attributes:
        radius_share: Frames whose rms distance to the zero is below this share of the training
            displacements' rms are rest (ours: 0.06 mm of 0.6 mm on the gel of data/force, whose
            markers scatter by 0.045 mm at rest; 0.075 to 0.1 are alike).
        frames: Rest frames over which the zero averages (ours: 30).
        prior_frames: Weight of the calibrated rest at the start, as rest frames (ours: 5).
    """

    radius_share: float = 0.1
    frames: int = 30
    prior_frames: int = 5

    def __post_init__(self) -> None:
        if self.radius_share < 0 or self.frames < 1 or self.prior_frames < 0:
            raise ValueError("radius_share and prior_frames must be >= 0, frames >= 1")


class RestZero:
    """The zero of one series, frame by frame."""

    def __init__(self, config: RestZeroConfig, radius: float, size: int) -> None:
        """Start at the calibrated rest.

        Args:
            config: How the zero follows.
            radius: Largest rms distance of a rest frame to the zero, in the field's unit.
            size: Numbers in a frame.
        """
        self._config, self._radius = config, radius
        self._seen = 0
        self.zero = np.zeros(size)

    def subtract(self, displacement: Field) -> Field:
        """Take in one frame ``(size,)`` and return it from the zero."""
        frames = self._seen + 1 + self._config.prior_frames
        share = max(1.0 / frames, 1.0 / self._config.frames)
        moved, away = np.ascontiguousarray(displacement, np.float64), np.empty(self.zero.size)
        self._seen += rest_kernel(moved, self._radius**2, share, self.zero, away)
        return away

    def subtract_all(self, displacements: Field) -> Field:
        """Take in ``(n, size)`` frames in order and return them from the zero of their time."""
        return np.array([self.subtract(row) for row in displacements]).reshape(displacements.shape)


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
