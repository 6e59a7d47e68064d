"""When a contact ends: the markers have come back.

Silence is no sign of an end: a finger that holds still is as silent as one that let go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.contact.rim import AFFINE_MODES
from spikingtac.contact.scales import ScaleTest, Vector
from spikingtac.contact.votes import POLARITIES


@dataclass(frozen=True, kw_only=True)
class ReleaseConfig:
    """When a contact counts as ended.

    Attributes:
        back_share: Share of the largest displacement that the markers have to come back (ours:
            each reversal costs the pixels a threshold before they fire, so that a whole return of
            a light touch shows as little more than a half).
        rest_windows: Windows after an end in which no contact is told: the gel springs back.
    """

    back_share: float = 0.6
    rest_windows: int = 50

    def __post_init__(self) -> None:
        if not 0.0 < self.back_share <= 1.0 or self.rest_windows < 0:
            raise ValueError("back_share must be in (0, 1], rest_windows not negative")


class ReleaseWatch:
    """Follows the markers along a contact's own direction until they are back.

    Only OFF votes count: the leak adds to the ON votes for as long as a contact lasts.

    Args:
        config: When a contact has ended.
        test: What the quiet windows taught.
        scale: The scale that decided.
        total: ``(length,)`` its votes then.
    """

    def __init__(self, config: ReleaseConfig, test: ScaleTest, scale: int, total: Vector) -> None:
        whiten = test.whiten[scale]
        off = np.zeros((len(total) // (POLARITIES * AFFINE_MODES), POLARITIES, AFFINE_MODES))
        off[:, 0] = 1.0
        self.along = whiten.T @ (whiten @ total)
        self._along_off = self.along * off.ravel()
        self._mean = float(self._along_off @ test.mean)
        self._left = 1.0 - config.back_share
        self._progress = self._peak = max(float(self._along_off @ total), 0.0)
        self._returning = False

    def add(self, votes: Vector) -> None:
        """Take the votes of the next window."""
        self._progress += float(self._along_off @ votes) - self._mean
        self._peak = max(self._peak, self._progress)

    def moved(self, total: Vector) -> None:
        """Take the votes of a scale that found a motion again: onwards, or back."""
        self._returning = float(self.along @ total) < 0.0

    def ended(self) -> bool:
        """Return True once a motion back was found and has led far enough."""
        return self._returning and self._progress <= self._left * self._peak
