"""Decide when a contact ends: when the markers have come back.

Silence is no sign of an end: a finger that holds still is as silent as one that let go.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from spikingtac.contact.motion.evidence_sums import POLARITIES
from spikingtac.contact.motion.rim_evidence import AFFINE_MODES
from spikingtac.contact.motion.scales import Vector
from spikingtac.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ReleaseConfig:
    """When a contact counts as ended.

    Attributes:
        back_share: The contact ends once the markers have come back by this share of their largest
            displacement, less the dead travel (ours: light presses of the twin come back by no
            more).
        dead_evidence: OFF evidence per marker that is lost at a reversal, since each pixel has to
            come back by up to two thresholds before it fires (measured on the twin: light presses).
        rest_windows: The contact ends after this many windows in a row without motion, once the
            markers are back.
    """

    back_share: float = 0.4
    dead_evidence: float = field(default=4.0, metadata={"former_names": ("dead_votes",)})
    rest_windows: int = 50

    def __post_init__(self) -> None:
        if not 0.0 < self.back_share <= 1.0 or self.dead_evidence < 0.0 or self.rest_windows < 0:
            raise ConfigError(
                "back_share must be in (0, 1], dead_evidence and rest_windows not negative"
            )


class ReleaseMonitor:
    """Follows the markers' common motion since a contact began, until they are back.

    It uses OFF evidence only: the leak adds to the ON evidence for as long as a contact lasts.

    Args:
        config: When a contact has ended.
        mean: ``(length,)`` evidence per window without contact.
        total: ``(length,)`` evidence of the contact up to the decision.
        markers: How many markers there are, over all sensors.
    """

    def __init__(self, config: ReleaseConfig, mean: Vector, total: Vector, markers: int) -> None:
        self._mean = _off(mean)
        self._moved = _off(total)
        self._farthest = self._moved.copy()
        self._length = float(np.linalg.norm(self._farthest))
        self._share = config.back_share
        self._dead = config.dead_evidence * markers
        self._returning = False

    def add(self, evidence: Vector) -> None:
        """Take the evidence of the next window."""
        self._moved += _off(evidence) - self._mean
        length = float(np.linalg.norm(self._moved))
        if length > self._length:
            self._farthest, self._length = self._moved.copy(), length

    def motion(self, total: Vector) -> bool:
        """Take the evidence of a scale that found a new motion; return True for a motion back."""
        self._returning = float(_off(total) @ self._farthest) < 0.0
        return self._returning

    def left(self) -> bool:
        """Return True once a motion back was found and has led far enough."""
        if not self._returning:
            return False
        back = float((self._farthest - self._moved) @ self._farthest) / self._length
        return back >= self._share * (self._length - self._dead)


def _off(evidence: Vector) -> Vector:
    return evidence.reshape(-1, POLARITIES, AFFINE_MODES)[:, 0].ravel().copy()
