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
from spikingtac.markers.graded.appearance import (
    appearance_of,
    painted_levels,
    painted_map,
    profile_tables,
)
from spikingtac.markers.graded.band_fit import fit_bands_kernel
from spikingtac.markers.graded.disc_locator import AGREEMENT, FIT_US
from spikingtac.markers.graded.motion import AT_US, MOST_VARIANCES, PP, VV, VX, X, resting_motion
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.state_map.bands import BandStateMap
from spikingtac.state_map.graded import PAD_PX

GROWTH_SHARE = 0.1
"""How much discs grow under load, as a share of their radius, on sensors whose pixels recover; on
others the radius stays (8 % by the events around the markers of the recorded gel; on its first two
presses they come from 1.12 to 0.97 px of the reference)."""

LEFT_BEHIND_PX = 8.0
"""So far outside of a disc its former places recover, px, if no other disc comes so near (ours:
most of a press's way)."""

SHORTEST_PERIOD_US = 1_000
"""Shortest time between two fits, us: in less too few pixels fire to tell a place (simulated, every
0.1 ms: 0.27 px instead of 0.17)."""

GROUPS = 4
"""The levels around every n-th marker recover at an estimate, in turn: each marker's every 4 ms, a
fiftieth of the time that it takes (ours)."""


class BandLocator:
    """Maximum a posteriori fits to a :class:`BandStateMap`, all markers at once.

    Attributes:
        map: The band map that it reads.
        motion: ``(m, 8)`` states (:mod:`spikingtac.markers.graded.motion`).
        outline_px: ``(m, 3)`` radius and second harmonic of each disc at rest, px.
        pending: ``(m,)`` events in each marker's cell; they are not asked here.
        largest_fall: Any: a band map does not leak.
    """

    largest_fall = float("inf")

    def __init__(self, calibration: Calibration) -> None:
        """Tabulate the profiles of a sensor's markers."""
        self._calibration = calibration
        self._start_px = calibration.reference_px.astype(np.float64)
        self._radius_px = calibration.radius_px.astype(np.float64)
        self._discs = self._radius_px, *profile_tables(appearance_of(calibration).profiles)
        self._recovery_s = calibration.recovery_s
        self._growth = GROWTH_SHARE if calibration.recovery_s is not None else 0.0
        self._within_px = recovering_px(self._start_px, self._radius_px, self._discs[2])
        self.map = painted_map(calibration, BandStateMap)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self.map.reset()
        self._rest(self._start_px)

    def begin_at(self, position_px: NDArray[np.float64]) -> None:
        """Begin with ``(m, 2)`` markers at rest elsewhere, px; the steps of the map stay."""
        self.map.repaint(painted_levels(self._calibration, position_px))
        self._rest(position_px)

    def _rest(self, position_px: NDArray[np.float64]) -> None:
        count = len(position_px)
        self.motion = resting_motion(position_px)
        self.motion[:, PP], self.motion[:, VV] = MOST_VARIANCES
        self._radii = np.column_stack([self._radius_px, np.zeros(count)])
        self._fits = np.zeros((count, 4))
        self._fits[:, :FIT_US], self._fits[:, AGREEMENT] = position_px, 1.0
        self.outline_px = np.column_stack([self._radius_px, np.zeros((count, 2))])
        self.pending = np.zeros(count, np.int64)
        self._recovered_us = np.full(count, -1, np.int64)
        self._turn = 0

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        at_us = self.motion[marker, -1]
        self.motion[marker] = resting_motion(position_px[marker])
        self.motion[marker, -1] = at_us
        for column, variance in zip((PP, VV), MOST_VARIANCES, strict=True):
            self.motion[marker, column] = variance
        self._radii[marker, 0], self._radii[marker, 1] = self._radius_px[marker], 0.0

    @property
    def agreement(self) -> NDArray[np.float64]:
        """``(m,)`` share of each edge that agrees with its disc, 0 to 1; a view."""
        return self._fits[:, AGREEMENT]

    @property
    def fitted_px(self) -> NDArray[np.float64]:
        """``(m, 2)`` where the discs were found, px; a view."""
        return self._fits[:, :FIT_US]

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Bring the motion of every marker up to ``t_us``, unless that was done just before."""
        if 0.0 <= self.motion[0, AT_US] > t_us - SHORTEST_PERIOD_US:
            return
        levels = self.map
        maps = levels.memory, levels.variance, levels.fired, levels.signed_steps, levels.turn
        states = self.motion, self._radii, self._fits, coasted
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


def banded(calibration: Calibration) -> Calibration:
    """Return a calibration with the steps that the band fit should have."""
    on, off = calibration.band_scale_on, calibration.band_scale_off
    if on is None or off is None:
        return calibration
    return calibration.with_steps_scaled(on, off)


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
