"""Whether the skin is back at its calibrated rest under a touch that began off it.

A recording that begins touched takes the touched skin for its rest, since a gel that has crept
looks alike. Its release then looks like a touch, and one that never ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.local_gradient import GradientOperator
from spikingtac.touch.touches.touch_config import TouchConfig

Field = NDArray[np.float64]

RETURN_FACTOR = 1.5
"""Times the strength of the rest from which it began that a touch must reach which began towards
the calibrated rest; what is weaker was the way there (ours: that way by itself reaches one)."""


class CalibratedRest:
    """Watches an open touch for the skin's return to where it was calibrated, causally."""

    def __init__(
        self, config: TouchConfig, gradient: GradientOperator, zero: Field, pattern: Field
    ) -> None:
        """Start where a touch begins.

        Args:
            config: When touches end.
            gradient: Of these markers.
            zero: ``(m, 2)`` rest from which it begins, from the calibrated one, px.
            pattern: ``(m, 2)`` of the touch from there, px.
        """
        self._still_us, self._gradient = config.still_us, gradient
        self._off, threshold = gradient.strength_of(zero), gradient.strength_of(pattern)
        self._limit = max(threshold, config.end_share * self._off)
        self._apart = self._off > threshold
        self._towards = bool((pattern * zero).sum() < 0.0)
        self._back_us: int | None = None

    def update(self, t_us: int, moved: Field) -> int | None:
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
        return self._back_us if t_us - self._back_us >= self._still_us else None

    def was_return(self, peak: float) -> bool:
        """Return whether a touch of this peak was the way back only: the skin is back now."""
        return self._back_us is not None and self._towards and peak < RETURN_FACTOR * self._off
