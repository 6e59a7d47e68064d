"""Tables of every marker's profile, for kernels that visit the pixels around a disc."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile

TABLE_ENTRIES = 1024
"""Entries of a table: steps of 1/80 px for an edge scale of 1 px."""


@dataclass(frozen=True, slots=True)
class ProfileTables:
    """What map maintenance reads of every marker.

    Attributes:
        values: ``(m, 3, TABLE_ENTRIES)`` float32: the level S(q), its flatness (1 where S is flat,
            0 where it is steepest), and dS/dq, 1/px.
        reach_px: ``(m,)`` a table goes from minus to plus this distance from the radius, px.
    """

    values: NDArray[np.float32]
    reach_px: NDArray[np.float64]

    def of(self, chosen: slice) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Return values and reaches of some markers."""
        return self.values[chosen], self.reach_px[chosen]


def profile_tables(profiles: list[DiscProfile]) -> ProfileTables:
    """Tabulate the profiles of all markers."""
    reach_px = np.array([profile.reach_px for profile in profiles])
    values = np.empty((len(profiles), 3, TABLE_ENTRIES), np.float32)
    for table, profile, reach in zip(values, profiles, reach_px, strict=True):
        q_px = np.linspace(-reach, reach, TABLE_ENTRIES)
        level, slope = profile.level(q_px), profile.slope(q_px)
        level[0], level[-1], slope[0], slope[-1] = 1.0, 0.0, 0.0, 0.0
        table[0], table[1], table[2] = level, 1.0 - np.sqrt(slope / slope.min()), slope
    return ProfileTables(values, reach_px)
