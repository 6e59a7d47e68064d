"""Sum the evidence of a window's events for each motion of the whole field."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.contact.motion.rim_evidence import AFFINE_MODES, OFF_RIM, RimTable
from spikingtac.contact.window import Window, packets_of
from spikingtac.errors import ConfigError

POLARITIES = 2
"""OFF and ON evidence are summed apart: the leak of the pixels fires ON only."""
SENSOR_VALUES = POLARITIES * AFFINE_MODES


class EvidenceSums:
    """Sums the evidence of each window, and keeps each marker's recent evidence.

    Args:
        tables: The rims of each sensor, in the windows' order.
        memory: How many windows of the markers' own evidence are kept.
    """

    def __init__(self, tables: Sequence[RimTable], memory: int) -> None:
        self.tables = tuple(tables)
        self.length = SENSOR_VALUES * len(self.tables)
        self._memory = memory
        self._evidence = np.zeros((len(self.tables), POLARITIES, AFFINE_MODES))
        self._recent = tuple(
            np.zeros((memory, len(table.center_px), 2), np.float32) for table in self.tables
        )
        self._filled = 0

    def add(self, window: Window) -> NDArray[np.float64]:
        """Return the window's evidence ``(length,)``: by sensor, OFF before ON, by mode.

        The next call overwrites the array.

        Raises:
            ConfigError: The window has another number of sensors than the calibrations, or
                sensors of another size.
        """
        packets = packets_of(window)
        if len(packets) != len(self.tables):
            raise ConfigError(
                f"the windows hold {len(packets)} sensors, the detector was built for "
                f"{len(self.tables)}"
            )
        slot = self._filled % self._memory
        for sensor, (packet, table) in enumerate(zip(packets, self.tables, strict=True)):
            packet.require_map(table.row.shape)
            evidence_kernel(
                packet.x, packet.y, packet.p, table.row, table.marker, table.modes,
                self._evidence[sensor], self._recent[sensor][slot],
            )  # fmt: skip
        self._filled += 1
        return self._evidence.reshape(-1)

    def recent(self, windows: int) -> tuple[NDArray[np.float64], ...]:
        """Return the evidence ``(m, 2)`` of each sensor's markers over the last windows."""
        kept = min(windows, self._filled, self._memory)
        slots = np.arange(self._filled - kept, self._filled) % self._memory
        return tuple(ring[slots].sum(axis=0, dtype=np.float64) for ring in self._recent)

    def reset(self) -> None:
        """Forget the markers' recent evidence."""
        self._filled = 0


@njit(cache=True)
def evidence_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    row: NDArray[np.int32],
    marker: NDArray[np.int32],
    modes: NDArray[np.float32],
    evidence: NDArray[np.float64],
    by_marker: NDArray[np.float32],
) -> None:
    """Sum a packet's evidence into ``evidence (2, modes)`` by polarity and ``by_marker (m, 2)``.

    The table's columns are separate parameters: a call with a tuple of arrays takes twice as long.
    """
    evidence[:] = 0.0
    by_marker[:] = 0.0
    for event in range(len(x)):
        place = row[y[event], x[event]]
        if place == OFF_RIM:
            continue
        polarity = 1 if p[event] else 0
        sign = 1.0 if p[event] else -1.0
        for mode in range(evidence.shape[1]):
            evidence[polarity, mode] += sign * modes[place, mode]
        of = marker[place]
        by_marker[of, 0] += sign * modes[place, 0]
        by_marker[of, 1] += sign * modes[place, 1]
