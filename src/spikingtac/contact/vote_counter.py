"""From the events of a window to one short vector: who voted for which motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.contact.detector import Window, packets_of
from spikingtac.contact.rim_votes import AFFINE_MODES, OFF_RIM, RimTable
from spikingtac.errors import ConfigError

POLARITIES = 2
"""OFF votes and ON votes stay apart: the leak of the pixels fires ON only."""
SENSOR_VOTES = POLARITIES * AFFINE_MODES


class VoteCounter:
    """Turns windows into votes, and remembers the recent ones of each marker.

    Args:
        tables: The rims of each sensor, in the windows' order.
        memory: How many windows of the markers' own votes are kept.
    """

    def __init__(self, tables: Sequence[RimTable], memory: int) -> None:
        self.tables = tuple(tables)
        self.length = SENSOR_VOTES * len(self.tables)
        self._memory = memory
        self._votes = np.zeros((len(self.tables), POLARITIES, AFFINE_MODES))
        self._recent = tuple(
            np.zeros((memory, len(table.center_px), 2), np.float32) for table in self.tables
        )
        self._filled = 0

    def count(self, window: Window) -> NDArray[np.float64]:
        """Return the window's votes ``(length,)``: by sensor, OFF before ON, by mode.

        The array is written anew by the next call.

        Raises:
            ConfigError: The window has another number of sensors than the calibrations.
        """
        packets = packets_of(window)
        if len(packets) != len(self.tables):
            raise ConfigError(
                f"the windows hold {len(packets)} sensors, the detector was built for "
                f"{len(self.tables)}"
            )
        slot = self._filled % self._memory
        for sensor, (packet, table) in enumerate(zip(packets, self.tables, strict=True)):
            votes_kernel(
                packet.x, packet.y, packet.p, table.row, table.marker, table.modes,
                self._votes[sensor], self._recent[sensor][slot],
            )  # fmt: skip
        self._filled += 1
        return self._votes.reshape(-1)

    def recent(self, windows: int) -> tuple[NDArray[np.float64], ...]:
        """Return the votes ``(m, 2)`` of each sensor's markers over the last windows."""
        kept = min(windows, self._filled, self._memory)
        slots = np.arange(self._filled - kept, self._filled) % self._memory
        return tuple(ring[slots].sum(axis=0, dtype=np.float64) for ring in self._recent)

    def reset(self) -> None:
        """Forget the markers' recent votes."""
        self._filled = 0


@njit(cache=True)
def votes_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    row: NDArray[np.int32],
    marker: NDArray[np.int32],
    modes: NDArray[np.float32],
    votes: NDArray[np.float64],
    by_marker: NDArray[np.float32],
) -> None:
    """Sum a packet's votes into ``votes (2, modes)`` by polarity and ``by_marker (m, 2)``.

    The columns of the table come one by one: a call with a tuple of arrays takes twice as long.
    """
    votes[:] = 0.0
    by_marker[:] = 0.0
    for event in range(len(x)):
        place = row[y[event], x[event]]
        if place == OFF_RIM:
            continue
        polarity = 1 if p[event] else 0
        sign = 1.0 if p[event] else -1.0
        for mode in range(votes.shape[1]):
            votes[polarity, mode] += sign * modes[place, mode]
        of = marker[place]
        by_marker[of, 0] += sign * modes[place, 0]
        by_marker[of, 1] += sign * modes[place, 1]
