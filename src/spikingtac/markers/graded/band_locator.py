"""Locate markers from the levels at which pixels fired: for sensors whose OFF events are rare."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelWatch
from spikingtac.markers.graded.appearance import appearance_of, painted_map, profile_tables
from spikingtac.markers.graded.band_fit import fit_bands_kernel
from spikingtac.markers.graded.locator import Locator
from spikingtac.markers.graded.motion import AT_US, MOST_VARIANCES, PP, VV
from spikingtac.state_map.bands import BandStateMap
from spikingtac.types import EventPacket

# Shortest time between two fits, us: in less too few pixels fire to tell a place (simulated,
# every 0.1 ms: 0.27 px instead of 0.17).
SHORTEST_PERIOD_US = 1_000


class BandLocator(Locator):
    """Maximum a posteriori fits to a :class:`BandStateMap`, all markers at once."""

    def __init__(self, calibration: Calibration) -> None:
        """Tabulate the profiles of a sensor's markers."""
        tables = profile_tables(appearance_of(calibration).profiles)
        self._discs = calibration.radius_px.astype(np.float64), *tables
        self._bands = painted_map(calibration, BandStateMap)
        super().__init__(calibration, self._bands)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        super().reset()
        self.motion[:, PP], self.motion[:, VV] = MOST_VARIANCES

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        super().place(marker, position_px)
        self.motion[marker, PP:AT_US] = MOST_VARIANCES[0], 0.0, MOST_VARIANCES[1]

    def absorb(self, packet: EventPacket, watch: HotPixelWatch) -> None:
        """Do what the base says."""
        kept = watch.kept(packet)
        self.map.absorb(kept)
        count_kernel(kept.x, kept.y, self._owner, self.counts)

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Do what the base says for every marker, unless that was done just before."""
        if 0.0 <= self.motion[0, AT_US] > t_us - SHORTEST_PERIOD_US:
            return
        levels = self._bands
        maps = levels.memory, levels.variance, levels.fired, levels.signed_steps, levels.turn
        states = self.motion, self.fits, coasted
        fit_bands_kernel((*maps, levels.padded), states, self._discs, t_us)
        levels.turn += 1


@njit(cache=True, nogil=True)
def count_kernel(
    x: NDArray[np.uint16], y: NDArray[np.uint16], owner: NDArray[np.uint16], counts: NDArray[Any]
) -> None:  # pragma: no cover - compiled
    """Count events for the markers that rest nearest."""
    for i in range(x.size):
        counts[owner[y[i], x[i]]] += 1
