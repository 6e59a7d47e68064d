"""What a motion must first undo before an event camera sees it.

After a motion every pixel at a marker's edge is closer to its next event in that direction than in
the other, so the first part of a motion the other way makes no event. Each marker is followed by a
point on a short slack string (:mod:`spikingtac.play_operator`): the string lies along the marker's
last motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.play_operator import within_play_kernel

Field = NDArray[np.float64]

STRING_PX = 0.2
"""Length of the string, px: motions below it say nothing of a direction (ours: 0.1 is alike)."""


@dataclass(frozen=True, kw_only=True)
class UnseenMotion:
    """What an event camera does not see of the beginning of a motion.

    Attributes:
        later_px: Of a motion after any earlier one, px (ours: with it the begins of 69 touches of
            the ten scenes of the twin are right on the average, 0.0 ms, seeds 3, 4 and 6; a pixel
            needs an edge to move by 0.2 px for one event).
        reversed_px: Further, where the motion reverses the last one, px (ours: as above).
    """

    later_px: float = 0.15
    reversed_px: float = 0.25

    def __post_init__(self) -> None:
        if self.later_px < 0 or self.reversed_px < 0:
            raise ValueError("later_px and reversed_px must not be negative")


NOTHING_UNSEEN = UnseenMotion(later_px=0.0, reversed_px=0.0)
"""For frames of a sensor that sees places and not changes."""


class Backlash:
    """The last motion of every marker."""

    def __init__(self, markers: int) -> None:
        """Start with markers that have never moved."""
        self._followed = np.zeros((markers, 2))
        self.string = np.zeros((markers, 2))

    def reset(self) -> None:
        """Forget every motion."""
        self._followed[:] = 0.0
        self.string = np.zeros_like(self._followed)

    def update(self, displacement: Field) -> Field:
        """Take in displacements ``(m, 2)`` and return the strings ``(m, 2)``, px."""
        self.string = np.empty_like(self._followed)
        moved = np.ascontiguousarray(displacement, np.float64)
        play_kernel(moved, STRING_PX, self._followed, self.string)
        return self.string


@njit(cache=True, nogil=True)
def play_kernel(displacement: Field, length: float, followed: Field, string: Field) -> None:
    """Let points on slack strings follow the markers.

    Args:
        displacement: ``(m, 2)`` of the markers.
        length: Of the strings.
        followed: ``(m, 2)`` the points; moved.
        string: ``(m, 2)`` overwritten by where each marker is from its point.
    """
    for marker in range(len(displacement)):
        x = displacement[marker, 0] - followed[marker, 0]
        y = displacement[marker, 1] - followed[marker, 1]
        string[marker, 0], string[marker, 1] = within_play_kernel(x, y, length)
        followed[marker, 0] = displacement[marker, 0] - string[marker, 0]
        followed[marker, 1] = displacement[marker, 1] - string[marker, 1]


def unseen_px(string: Field, pattern: Field, unseen: UnseenMotion) -> float:
    """Return how far the skin moves along a pattern ``(m, 2)`` before that is seen, px."""
    strength = (pattern * pattern).sum(axis=1)
    total = float(strength.sum())
    if total <= 0.0:
        return 0.0
    weight = strength / total
    moved = np.sqrt((string * string).sum(axis=1)) / STRING_PX
    along = (string * pattern).sum(axis=1) / np.sqrt(np.maximum(strength, 1e-12)) / STRING_PX
    reversal = max(0.0, -float(weight @ along))
    return unseen.later_px * float(weight @ moved) + unseen.reversed_px * reversal
