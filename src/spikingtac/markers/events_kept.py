"""How many of the events that the motion asks for arrive: cameras and cables lose some.

A disc of radius R that moves by a distance sweeps 4 R of edge per px (its width, on the leading and
on the trailing side), and every swept pixel swings fully, which takes 1/step - 1 events of a clean
stream (the dead band takes the rest). The share of events over that expectation, measured while the
markers move, tells the loss; what arrives at rest is background. A reversal costs up to a step of
every pixel and a filtered velocity lags, so that the share is judged over many reversals.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.state_map.graded import STEP_DEFAULT
from spikingtac.types import Calibration

MOVING_PX_S = 30.0
"""Mean speed above which events are counted against the motion: well above creep and jitter."""

STILL_PX_S = 3.0
"""Mean speed below which events are background."""

BACKGROUND_MEMORY_S = 0.5
"""Time constant of the background's running mean."""

FIRST_EVENTS = 50_000.0
"""Expected events before the first judgement: some tenths of a second of lively motion."""

MEMORY_EVENTS = 200_000.0
"""Expected events over which the share is averaged; single strokes scatter by a quarter."""

FULL_SHARE = 0.87
"""A share above this is within the spread of lossless recordings and counts as 1."""

SMALLEST_SHARE = 0.2
"""Below this no map can be kept; the steps grow no further."""

SHARE_CHANGE = 0.03
"""Changes of the share smaller than this leave the steps alone."""


class EventsKept:
    """Watches the stream for loss."""

    def __init__(self, calibration: Calibration) -> None:
        """Begin without loss."""
        step = 0.5 * (
            (calibration.step_on or STEP_DEFAULT) + (calibration.step_off or STEP_DEFAULT)
        )
        self._events_per_px = 4.0 * calibration.radius_px * (1.0 / step - 1.0)
        self._background_per_s: float | None = None
        self._expected = 0.0
        self._arrived = 0.0
        self._share = 1.0

    def update(self, events: int, velocity_px_s: NDArray[np.float64], dt_s: float) -> float | None:
        """Count a stretch of time.

        Args:
            events: Events that arrived.
            velocity_px_s: ``(m, 2)`` the markers' velocities, px/s.
            dt_s: Length of the stretch, s.

        Returns:
            The new share of events that arrive, when it changed; None otherwise.
        """
        if dt_s <= 0.0:
            return None
        mean_px_s, events_per_s = _motion_kernel(velocity_px_s, self._events_per_px)
        if mean_px_s < STILL_PX_S:
            self._learn_background(events / dt_s, dt_s)
        if mean_px_s <= MOVING_PX_S:
            return None
        expected = events_per_s * dt_s
        kept = 1.0 - min(expected / MEMORY_EVENTS, 1.0)
        self._expected = kept * self._expected + expected
        self._arrived = kept * self._arrived + events - (self._background_per_s or 0.0) * dt_s
        return self._judged() if self._expected > FIRST_EVENTS else None

    def _judged(self) -> float | None:
        share = self._arrived / self._expected
        share = 1.0 if share > FULL_SHARE else max(share, SMALLEST_SHARE)
        if abs(share - self._share) < SHARE_CHANGE:
            return None
        self._share = share
        return share

    def _learn_background(self, rate_per_s: float, dt_s: float) -> None:
        if self._background_per_s is None:
            self._background_per_s = rate_per_s
        gain = 1.0 - np.exp(-dt_s / BACKGROUND_MEMORY_S)
        self._background_per_s += gain * (rate_per_s - self._background_per_s)


@njit(cache=True, nogil=True)
def _motion_kernel(
    velocity_px_s: NDArray[np.float64], events_per_px: NDArray[np.float64]
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the mean speed, px/s, and the events that the motion asks for, 1/s."""
    total = events = 0.0
    for m in range(velocity_px_s.shape[0]):
        speed = np.hypot(velocity_px_s[m, 0], velocity_px_s[m, 1])
        total += speed
        events += events_per_px[m] * speed
    return total / velocity_px_s.shape[0], events
