"""What the locators of discs and bands share: the flat states of one sensor's markers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelWatch
from spikingtac.markers.graded.appearance import nearest_marker
from spikingtac.markers.graded.motion import AGREEMENT, FIT_US, VX, X, resting_fits, resting_motion
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket

AT_ONCE = 1 << 30  # Events that are due for any marker.


class Locator:
    """Finds the markers of one sensor on a map of levels.

    Attributes:
        map: The map that it reads.
        motion: ``(m, 8)`` states of the markers (:mod:`spikingtac.markers.graded.motion`).
        fits: ``(m, 7)`` what was fitted last (the same module).
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
        pending: ``(m,)`` events at each marker's edge since its last fit.
        counts: ``(m,)`` events in each marker's cell, nearest to its rest, since they were taken.
    """

    def __init__(self, calibration: Calibration, state_map: GradedStateMap) -> None:
        """Begin at rest."""
        self._start_px = calibration.reference_px.astype(np.float64)
        self._radius_px = calibration.radius_px.astype(np.float64)
        self._owner = nearest_marker(calibration.reference_px, calibration.size)
        self.map = state_map
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        count = len(self._start_px)
        self.map.reset()
        self.motion = resting_motion(self._start_px)
        self.fits = resting_fits(self._start_px)
        self.outline_px = np.column_stack([self._radius_px, np.zeros((count, 2))])
        self.pending, self.counts = np.zeros((2, count), np.int64)

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.motion[marker, X:VX] = position_px[marker]
        self.motion[marker, VX : VX + 2] = 0.0
        self.pending[marker] = AT_ONCE

    @property
    def agreement(self) -> NDArray[np.float64]:
        """``(m,)`` share of each edge that agrees with its disc, 0 to 1; a view."""
        return self.fits[:, AGREEMENT]

    @property
    def fitted_px(self) -> NDArray[np.float64]:
        """``(m, 2)`` where the discs were found, px; a view."""
        return self.fits[:, :FIT_US]

    def absorb(self, packet: EventPacket, watch: HotPixelWatch) -> None:
        """Bring the map up to date, and count the events by marker, but for those of hot pixels.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        raise NotImplementedError

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Bring the motion of every marker that asks for it up to ``t_us``.

        Args:
            t_us: The time, us.
            coasted: ``(m,)`` markers that are held: their motion stays.
        """
        raise NotImplementedError
