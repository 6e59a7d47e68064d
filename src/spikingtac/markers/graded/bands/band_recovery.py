"""Levels of pixels that forget light which they lost without an event.

A pixel that is darker than at its last event, by less than an OFF step, comes to take the darker
level for granted: the level from which its next event counts sinks to what the disc shows. So on
sensors that recover (:mod:`spikingtac.markers.calibration.recovery`) a level never stays
above its disc at rest, and every rest is an anchor. Ours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.state_map.graded import PAD_PX

LEFT_BEHIND_PX = 8.0
"""So far outside of a disc its former places recover, px, if no other disc comes so near (ours:
most of a press's way)."""

GROUPS = 4
"""The levels around every n-th marker recover at an estimate, in turn: each marker's every 4 ms, a
fiftieth of the time that it takes (ours)."""


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


class RecoveryTurns:
    """Divides the markers into groups whose levels recover in turn, one at each estimate."""

    def __init__(self, markers: int, recovery_s: float) -> None:
        """Begin with nothing given up; ``recovery_s`` is the time constant, s."""
        self._since_s, self._recovery_s, self._turn = np.zeros(markers), recovery_s, 0

    def shares(self, dt_s: float) -> NDArray[np.float64]:
        """Return the ``(m,)`` shares that are given up now, ``dt_s`` after the last call, s."""
        self._since_s += dt_s
        self._turn = (self._turn + 1) % GROUPS
        share, due = np.zeros(len(self._since_s)), slice(self._turn, None, GROUPS)
        share[due] = -np.expm1(-self._since_s[due] / self._recovery_s)
        self._since_s[due] = 0.0
        return share


@njit(cache=True, nogil=True, error_model="numpy")
def recover_levels_kernel(
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    center_px: NDArray[np.float64],
    discs: tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64]],
    within_px: NDArray[np.float64],
    share: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Let levels that lie above their disc give up a share of that.

    Args:
        padded: Expected levels with their margin of PAD_PX; changed.
        memory: ``(height, width)`` levels of the last events; changed.
        center_px: ``(m, 2)`` disc centres, px.
        discs: ``(m,)`` radii, px; values and reaches of `profile_tables.ProfileTables`.
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
