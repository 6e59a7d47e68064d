"""The events at the rims of the last second, counted by time, cell and polarity."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.vibration.rim_cells import CELLS, NO_CELL, RINGS, SECTORS, Cells
from spikingtac.types import EventPacket

Counts = NDArray[np.uint16]

BIN_US = 250
"""Width of a bin of time, us: a line of 500 Hz keeps 97.5 % of its strength, which is known."""
FULL = np.iinfo(np.uint16).max
"""A bin counts no further."""


class RimMemory:
    """A ring of bins; memory does not grow with the recording.

    Attributes:
        t_us: End of the last bin that is complete, us; None before the first event.
    """

    def __init__(self, bins: int) -> None:
        """Start empty, with room for ``bins`` bins."""
        # One row more than is kept: that of the bin which is not complete yet.
        self._bins, self._counts = bins, np.zeros((bins + 1, 2 * CELLS), np.uint16)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._counts[:] = 0
        self._first: int | None = None
        self._end = 0

    @property
    def full(self) -> bool:
        """True when the whole ring has been watched."""
        return self._first is not None and self._end - self._first >= self._bins

    @property
    def t_us(self) -> int | None:
        """End of the last complete bin, us; None before anything was watched."""
        return None if self._first is None else self._end * BIN_US

    def absorb(self, packet: EventPacket, cell: Cells) -> None:
        """Count the events of a packet.

        Args:
            packet: Events in order of time; its span moves the ring on, silence too.
            cell: ``(height, width)`` cell of each pixel.

        Raises:
            ConfigError: The packet is of another sensor.
        """
        packet.require_map(cell.shape)
        start, end = packet.t_start_us // BIN_US, packet.t_end_us // BIN_US
        if self._first is None or start < self._end - 1:
            self.reset()
            self._first, self._end = start, start
        self._advance(end)
        first = int(np.searchsorted(packet.t, (end - self._bins) * BIN_US))
        kept = packet.part(first, len(packet), packet.t_start_us, packet.t_end_us)
        count_events_kernel(kept.x, kept.y, kept.p, kept.t, cell, self._counts)

    def counts(self) -> NDArray[np.float32]:
        """Return ``(bins, RINGS, SECTORS, 2)`` counts, oldest bin first; OFF, then ON."""
        order = np.arange(self._end - self._bins, self._end) % len(self._counts)
        shape = (len(order), RINGS, SECTORS, 2)
        return self._counts[order].astype(np.float32).reshape(shape)

    def _advance(self, end: int) -> None:
        """Clear the bins up to the one that holds the end of a packet; it is not complete yet."""
        rows = len(self._counts)
        fresh = np.arange(max(self._end, end - rows) + 1, end + 1)
        self._counts[fresh % rows] = 0
        self._end = max(self._end, end)


@njit(cache=True, nogil=True)
def count_events_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    t: NDArray[np.int64],
    cell: Cells,
    counts: Counts,
) -> None:
    """Count events ``(n,)`` at the rims into ``counts``, ``(bins, 2 CELLS)``."""
    bins = len(counts)
    for event in range(len(t)):
        here = cell[y[event], x[event]]
        if here == NO_CELL:
            continue
        row = (t[event] // BIN_US) % bins
        column = 2 * here + (1 if p[event] else 0)
        if counts[row, column] < FULL:
            counts[row, column] += 1
