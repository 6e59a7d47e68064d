"""When a contact ends: the markers have come back.

MissingMarkers is no sign of an end: a finger that holds still is as silent as one that let go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.contact.rim_votes import AFFINE_MODES
from spikingtac.contact.scales import Vector
from spikingtac.contact.vote_counter import POLARITIES


@dataclass(frozen=True, kw_only=True)
class ReleaseConfig:
    """When a contact counts as ended.

    Attributes:
        back_share: Share of the largest displacement, less the dead travel, that the markers have
            to come back (ours: light presses of the twin show as little as that).
        dead_votes: OFF votes per marker that a reversal swallows, since each pixel has to come back
            by up to two thresholds before it fires (measured on the twin: light presses).
        rest_windows: Windows in a row without a motion, after the way back, that make the end.
    """

    back_share: float = 0.4
    dead_votes: float = 4.0
    rest_windows: int = 50

    def __post_init__(self) -> None:
        if not 0.0 < self.back_share <= 1.0 or self.dead_votes < 0.0 or self.rest_windows < 0:
            raise ValueError(
                "back_share must be in (0, 1], dead_votes and rest_windows not negative"
            )


class ReleaseWatch:
    """Follows the markers' common motion since a contact began, until they are back.

    Only OFF votes count: the leak adds to the ON votes for as long as a contact lasts.

    Args:
        config: When a contact has ended.
        mean: ``(length,)`` votes per window without contact.
        total: ``(length,)`` votes up to the decision.
        markers: How many markers there are, over all sensors.
    """

    def __init__(self, config: ReleaseConfig, mean: Vector, total: Vector, markers: int) -> None:
        self._mean = _off(mean)
        self._moved = _off(total)
        self._farthest = self._moved.copy()
        self._length = float(np.linalg.norm(self._farthest))
        self._share = config.back_share
        self._dead = config.dead_votes * markers
        self._returning = False

    def add(self, votes: Vector) -> None:
        """Take the votes of the next window."""
        self._moved += _off(votes) - self._mean
        length = float(np.linalg.norm(self._moved))
        if length > self._length:
            self._farthest, self._length = self._moved.copy(), length

    def motion(self, total: Vector) -> bool:
        """Take the votes of a scale that found a motion again; return True for a motion back."""
        self._returning = float(_off(total) @ self._farthest) < 0.0
        return self._returning

    def left(self) -> bool:
        """Return True once a motion back was found and has led far enough."""
        if not self._returning:
            return False
        back = float((self._farthest - self._moved) @ self._farthest) / self._length
        return back >= self._share * (self._length - self._dead)


def _off(votes: Vector) -> Vector:
    return votes.reshape(-1, POLARITIES, AFFINE_MODES)[:, 0].ravel().copy()
