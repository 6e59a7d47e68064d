"""Locate markers from the levels at which pixels fired: for sensors whose OFF events are rare.

On sensors that recover, pixels forget light which they lost without an event. A pixel that is
darker than at its last event, by less than an OFF step, comes to take the darker level for granted:
the level from which its next event counts sinks to what the disc shows. So a level never stays
above its disc at rest, and every rest is an anchor. Ours.
"""

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
from spikingtac.markers.graded.motion import AT_US, MOST_VARIANCES, PP, VV, VX, X
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.state_map.bands import BandStateMap
from spikingtac.state_map.graded import PAD_PX
from spikingtac.types import EventPacket

# How much discs grow under load, as a share of their radius, on sensors whose pixels recover; on
# others the radius stays (8 % by the events around the markers of the recorded gel; on its first
# two presses they come from 1.12 to 0.97 px of the reference).
GROWTH_SHARE = 0.1

# So far outside of a disc its former places recover, px, if no other disc comes so near (ours:
# most of a press's way).
LEFT_BEHIND_PX = 8.0

# Shortest time between two fits, us: in less too few pixels fire to tell a place (simulated,
# every 0.1 ms: 0.27 px instead of 0.17).
SHORTEST_PERIOD_US = 1_000

# The levels around every n-th marker recover at an estimate, in turn: each marker's every 4 ms, a
# fiftieth of the time that it takes (ours).
GROUPS = 4


class BandLocator(Locator):
    """Maximum a posteriori fits to a :class:`BandStateMap`, all markers at once."""

    def __init__(self, calibration: Calibration) -> None:
        """Tabulate the profiles of a sensor's markers."""
        tables = profile_tables(appearance_of(calibration).profiles)
        self._discs = calibration.radius_px.astype(np.float64), *tables
        self._recovery_s = calibration.recovery_s
        self._growth = GROWTH_SHARE if calibration.recovery_s is not None else 0.0
        self._within_px = recovering_px(
            calibration.reference_px.astype(np.float64), self._discs[0], self._discs[2]
        )
        self._bands = painted_map(calibration, BandStateMap)
        super().__init__(calibration, self._bands)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        super().reset()
        count = len(self.motion)
        self.motion[:, PP], self.motion[:, VV] = MOST_VARIANCES
        self._radii = np.column_stack([self._radius_px, np.zeros(count)])
        self._recovered_us = np.full(count, -1, np.int64)
        self._turn = 0

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        super().place(marker, position_px)
        self.motion[marker, PP:AT_US] = MOST_VARIANCES[0], 0.0, MOST_VARIANCES[1]
        self._radii[marker, 0], self._radii[marker, 1] = self._radius_px[marker], 0.0

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
        states = self.motion, self._radii, self.fits, coasted
        fit_bands_kernel((*maps, levels.padded), states, self._discs, t_us, self._growth)
        levels.turn += 1
        if self._recovery_s is not None:
            self._recover(t_us, self._recovery_s)

    def _recover(self, t_us: int, recovery_s: float) -> None:
        """Let the levels around some markers sink to what their discs show."""
        self._turn = (self._turn + 1) % GROUPS
        some = slice(self._turn, None, GROUPS)
        since_us = np.where(self._recovered_us[some] < 0, 0, t_us - self._recovered_us[some])
        self._recovered_us[some] = t_us
        recover_levels_kernel(
            self.map.padded,
            self.map.memory,
            self.motion[some, X:VX],
            (self._radii[some, 0], *(values[some] for values in self._discs[1:])),
            self._within_px[some],
            -np.expm1(-since_us * 1e-6 / recovery_s),
        )


def recovering_px(
    reference_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    reach_px: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return ``(m,)`` distances from each disc's centre within which levels recover, px.

    Args:
        reference_px: ``(m, 2)`` where the markers rest, px.
        radius_px: ``(m,)`` their radii, px.
        reach_px: ``(m,)`` how far beyond them their edges reach, px.
    """
    disc_px = radius_px + reach_px
    if len(reference_px) < 2:
        return disc_px + LEFT_BEHIND_PX
    return np.clip(0.5 * smallest_spacing_px(reference_px), disc_px, disc_px + LEFT_BEHIND_PX)


@njit(cache=True, nogil=True)
def count_kernel(
    x: NDArray[np.uint16], y: NDArray[np.uint16], owner: NDArray[np.uint16], counts: NDArray[Any]
) -> None:  # pragma: no cover - compiled
    """Count events for the markers that rest nearest."""
    for i in range(x.size):
        counts[owner[y[i], x[i]]] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def recover_levels_kernel(
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    center_px: NDArray[np.float64],
    discs: tuple[Any, ...],
    within_px: NDArray[np.float64],
    share: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Let levels that lie above their disc give up a share of that.

    Args:
        padded: Expected levels with their margin of PAD_PX; changed.
        memory: ``(height, width)`` levels of the last events; changed.
        center_px: ``(m, 2)`` disc centres, px.
        discs: ``(m,)`` radii, px; values and reaches of
            :func:`~spikingtac.markers.graded.appearance.profile_tables`.
        within_px: ``(m,)`` distances from the centres within which levels recover, px.
        share: ``(m,)`` shares of the excess that are given up around each; 0 passes a marker by.
    """
    radius_px, tables, reach_px = discs
    height, width = memory.shape
    last = tables.shape[2] - 1
    for m in range(center_px.shape[0]):
        if share[m] == 0.0:
            continue
        x, y, far = center_px[m, 0], center_px[m, 1], within_px[m]
        scale, ground = 0.5 * last / reach_px[m], tables[m, 0, last]
        for row in range(max(0, int(np.ceil(y - far))), min(height - 1, int(y + far)) + 1):
            half = np.sqrt(max(far * far - (row - y) ** 2, 0.0))
            for column in range(max(0, int(np.ceil(x - half))), min(width - 1, int(x + half)) + 1):
                if memory[row, column] <= ground:  # no disc is darker than its ground
                    continue
                rho = np.sqrt((column - x) ** 2 + (row - y) ** 2)
                place = (rho - radius_px[m] + reach_px[m]) * scale
                shown = tables[m, 0, min(max(int(place), 0), last)]
                excess = memory[row, column] - shown
                if excess > 0.0:
                    given_up = np.float32(share[m] * excess)
                    memory[row, column] -= given_up
                    padded[row + PAD_PX, column + PAD_PX] -= given_up
