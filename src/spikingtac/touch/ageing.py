"""How many events in a row a pixel gives when an edge sweeps it wholly: the swing, in events.

Where a marker moves by more than its edge is wide, the pixels that it uncovers go from the marker's
light to the ground's and give one event for each step: a calibration knows how many. Paint that
fades, a gel that turns dull, a lamp that weakens or a threshold that was changed all leave fewer.
Needs no tracker but to know which markers moved.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.types import EventPacket

Field = NDArray[np.float64]

# Motion of a marker that sweeps its edge wholly, px (ours: three widths of an edge).
LEAST_MOTION_PX = 4.0
LEAST_MARKERS = 8  # Markers that must have moved so far before anything is told.
RIM_PX = 2.0  # Pixels within this distance of the resting edge are looked at, px.

# Share of a marker's pixels whose longest run is no longer than the one that counts: most of the
# rim along the motion is swept, and no run is longer than a swing but by noise.
QUANTILE = 0.9

# Events further apart are no run: the leak of a resting pixel would make one (ours: the leak of a
# pixel comes every ten seconds, an edge at 1 px/s crosses in two).
LONGEST_GAP_US = 2_000_000

# Share of the calibrated swing below which it has faded (ours, simulated: 21 recordings of a
# fresh gel 0.87 to 1.14).
FADED_SWING = 0.85
LONGEST_RUN = np.iinfo(np.int16).max


@dataclass(frozen=True, slots=True)
class Swing:
    """The swing of the events, compared with the calibration.

    Attributes:
        share: Of the calibrated swing in logarithmic intensity; 1 is unchanged.
        markers: Markers that moved far enough to tell.
    """

    share: float
    markers: int

    @property
    def faded(self) -> bool:
        """True where it is clearly smaller than it was."""
        return self.share < FADED_SWING

    def words(self) -> str:
        """Return a sentence for the user."""
        return (
            f"an edge gives {100 * self.share:.0f} % of the events that it gave at the calibration "
            f"({self.markers} markers): the paint or the gel has faded, or lamp or thresholds were "
            "changed; record slides and calibrate again"
        )


class SwingRuns:
    """Follows the runs of events at the markers' rims."""

    def __init__(self, calibration: Calibration) -> None:
        """Start with a fresh count."""
        self._calibration = calibration
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        width, height = calibration.size
        self._run = np.zeros((height, width), np.int16)
        self._last_us = np.zeros((height, width), np.int64)
        self._longest = np.zeros((2, height, width), np.int16)
        self._moved = np.zeros(len(calibration.reference_px))

    def absorb(self, packet: EventPacket) -> None:
        """Take in events in order of time.

        Raises:
            ConfigError: They are of another sensor.
        """
        packet.require_map(self._run.shape)
        packet = self._hot.kept(packet)
        longest_runs_kernel(
            (packet.x, packet.y, packet.p, packet.t), self._run, self._last_us, self._longest
        )

    def passing(self, packets: Iterable[EventPacket]) -> Iterator[EventPacket]:
        """Pass packets on, and take them in.

        Raises:
            ConfigError: They are of another sensor.
        """
        for packet in packets:
            self.absorb(packet.sound())
            yield packet

    def follow(self, displacement: Field) -> None:
        """Take in displacements ``(m, 2)`` from the calibrated rest, px."""
        np.maximum(self._moved, (displacement**2).sum(axis=1), out=self._moved)

    def swing(self) -> Swing | None:
        """Return the swing; None while too few markers moved, or the calibration has no steps."""
        known = self._calibration
        moved = np.flatnonzero(self._moved > LEAST_MOTION_PX**2)
        if known.step_on is None or known.step_off is None or len(moved) < LEAST_MARKERS:
            return None
        steps = np.array([known.step_off, known.step_on])
        shares = [steps @ self._runs(marker) / 2.0 for marker in moved.tolist()]
        return Swing(float(np.median(shares)), len(moved))

    def _runs(self, marker: int) -> Field:
        """Return the runs ``(2,)`` of a marker's rim, OFF and ON."""
        center = self._calibration.reference_px[marker]
        radius = float(self._calibration.radius_px[marker])
        reach = int(np.ceil(radius + RIM_PX))
        height, width = self._run.shape
        left, top = np.maximum(np.rint(center).astype(int) - reach, 0).tolist()
        box = (slice(top, min(top + 2 * reach + 1, height)),
               slice(left, min(left + 2 * reach + 1, width)))  # fmt: skip
        y, x = np.mgrid[box]
        rim = np.abs(np.hypot(x - center[0], y - center[1]) - radius) < RIM_PX
        found = self._longest[:, *box][:, rim]
        if not found.size:
            return np.zeros(2)
        return np.asarray(np.quantile(found, QUANTILE, axis=1), np.float64)


@njit(cache=True, nogil=True)
def longest_runs_kernel(
    events: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]],
    run: NDArray[np.int16],
    last_us: NDArray[np.int64],
    longest: NDArray[np.int16],
) -> None:
    """Count events of one polarity in a row.

    Args:
        events: Columns x, y, p, t.
        run: ``(height, width)`` length of the present run, negative for OFF.
        last_us: ``(height, width)`` time of the last event, us.
        longest: ``(2, height, width)`` length of the longest run, OFF and ON.
    """
    x, y, p, t = events
    for event in range(len(x)):
        row, column = y[event], x[event]
        sign = 1 if p[event] else -1
        goes_on = run[row, column] * sign > 0
        goes_on = goes_on and t[event] - last_us[row, column] <= LONGEST_GAP_US
        length = min(abs(run[row, column]) + 1, LONGEST_RUN) if goes_on else 1
        run[row, column], last_us[row, column] = sign * length, t[event]
        kind = 1 if sign > 0 else 0
        if length > longest[kind, row, column]:
            longest[kind, row, column] = length
