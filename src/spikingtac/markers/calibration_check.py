"""Test whether a recording comes from the calibrated sensor.

A pixel just inside of a resting marker's rim can only darken at first, and one just outside can
only brighten. So the polarity of its first event shows on which side of the rim it lies, for any
motion. If the markers have other positions or sizes than in the calibration, many pixels contradict
it. The test needs no tracker, which might have adapted to a wrong calibration.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.markers.graded.appearance import painted_levels
from spikingtac.types import EventPacket

# Levels at rest of the tested pixels: between both zones a pixel can rise and fall, farther out the
# texture of the ground matters. (To 0.04 and 0.96 too few pixels are left to tell a foreign
# calibration from slides and presses of 1.6 s; to 0.016 and 0.984 the answers are the same.)
OUTSIDE_LEVELS, INSIDE_LEVELS = (0.02, 0.1), (0.9, 0.98)

# An event is supported if so many of its eight neighbours sent an event of the same polarity within
# this time before it; noise is not.
NEIGHBOUR_US, NEIGHBOURS = 20_000, 2

# Mark of a pixel whose first supported event belongs to a return: its event before, or an event
# within RETURN_US, had the other polarity, from a slow motion without supported events.
NO_ANSWER = 2

# Time in which the several events of a return come. (A touch ends in 0.1 to 0.3 s; noise of 0.1 Hz
# per pixel spoils one first event in ten.)
RETURN_US = 1_000_000

# Events by which a pixel has left its level the other way: then it returns, too, however slowly. (A
# simulated press of 12 s lets 28 % contradict the sensor's own calibration without.)
MOVED_EVENTS = 2

# Noise of a pixel, Hz, above which both times are shorter in proportion: it supports no more then
# (0.3 %), nor spoils more. (At 4 Hz the full times let 11 % contradict a simulated sensor's own
# calibration, these 1 %; 9 % where the markers stand 1.5 px elsewhere.)
NOISE_HZ = 1.0

# Time between two tests, by the stream's own clock: contradictions come with the first pixels of a
# motion, and are diluted by the pixels that fast strokes add.
TURN_US = 50_000
SHORT_TURNS = 2  # The first turn is empty, and the second one may begin late.

NOISE_TURNS = 10  # Tests after which first events of resting markers are discarded as noise.

# A marker with fewer new pixels in half a second was at rest: they were noise, and are tested
# again. (Noise of 1 Hz per pixel brings 0.7.)
FEWEST_NEW = 3

# Pixels on either side of the rims before the first test: 8 markers that moved by 2 px.
FEWEST_PIXELS = 100

# Standard errors that are subtracted from a share: 95 % of chance values do not exceed the limit.
STANDARD_ERRORS = 1.64

# Share of contradictions that is never suspicious. (200 simulated recordings with their own
# calibration stay below 0.032, the recorded sensor at 0.033; with that of another specimen 199
# exceed 0.06.)
MOST_CONTRADICTION = 0.06

# The test ends when this share of the pixels has fired: later first events follow motions without
# supported events.
ENOUGH_SHARE = 0.5


class CalibrationCheck:
    """Tests a stream against a calibration, until it is decided or enough pixels have fired.

    Args:
        calibration: The calibration with which the stream is tracked.

    Attributes:
        contradiction: Largest lower confidence bound so far of the share of contradicting pixels,
            the smaller of both sides of the rims; 0 until enough pixels have fired.
        limit: Share above which the calibration belongs to another sensor.
        measured: True once enough pixels have fired.
        ended: True once the result is final.
    """

    def __init__(self, calibration: Calibration) -> None:
        level, owner = painted_levels(calibration)
        outside = (level > OUTSIDE_LEVELS[0]) & (level < OUTSIDE_LEVELS[1])
        tested = outside | (level > INSIDE_LEVELS[0]) & (level < INSIDE_LEVELS[1])
        if calibration.marker_measured is not None:
            tested &= calibration.marker_measured[owner]
        self._marker = owner[tested]
        self._outside = outside[tested]
        self._tested = tested
        self._first = np.zeros(tested.shape, np.int8)
        self._kept = np.zeros(len(self._marker), np.int8)
        self._turn = 0
        self._last_us = np.full((2, *tested.shape), np.iinfo(np.int64).min // 2)
        self._net = np.zeros(tested.shape, np.int32)
        self._dark = calibration.polarity == "dark"
        self._filter = HotPixelFilter(calibration.hot_px, calibration.size)
        self._turn_us = int(np.iinfo(np.int64).min)
        self._events, self._noise_hz = 0, 0.0
        self.limit = MOST_CONTRADICTION
        self.contradiction, self.measured = 0.0, False
        self.ended = not len(self._marker)

    @property
    def foreign(self) -> bool:
        """True where the recording contradicts the calibration."""
        return self.contradiction > self.limit

    def words(self) -> str:
        """Return what was found and what to do, as a sentence."""
        return (
            f"the recording does not fit the calibration: {self.contradiction:.0%} of the pixels "
            f"beside the markers' rims changed first to the wrong side (at most {self.limit:.0%} "
            "with the sensor's own); the calibration is another sensor's or lacks edge_px, or "
            "something pressed at first; calibrate this sensor: spikingtac calibrate RECORDING"
        )

    def absorb(self, packet: EventPacket) -> None:
        """Process the next packet; any division of the stream gives the same result."""
        rest = self._filter.kept(packet)
        while len(rest) and not self.ended:
            part, rest = rest.split(self._turn_us)
            events = part.x, part.y, part.p != self._dark, part.t
            share = NOISE_HZ / max(self._noise_hz, NOISE_HZ)
            _note_first_kernel(events, self._tested, self._first, self._last_us, self._net, share)
            self._events += len(part)
            if len(rest):
                self._test()
                self._turn_us = (int(rest.t[0]) // TURN_US + 1) * TURN_US

    def finish(self) -> None:
        """Test the events since the last test."""
        if not self.ended:
            self._test()

    def _test(self) -> None:
        first = self._first[self._tested]
        self.contradiction = max(self.contradiction, self._share(first))
        self.measured |= bool(np.count_nonzero(first) >= FEWEST_PIXELS)
        self._turn += 1
        hz = self._events / (self._tested.size * TURN_US * 1e-6)
        if self._turn > SHORT_TURNS:
            self._noise_hz = min(self._noise_hz or hz, hz)
        self._events = 0
        if self._turn % NOISE_TURNS == 0:
            self._forget_noise(first)
        self.ended = self.foreign or bool((self._kept != 0).mean() > ENOUGH_SHARE)

    def _forget_noise(self, first: NDArray[np.int8]) -> None:
        new = (first != 0) & (self._kept == 0)
        moved = np.bincount(self._marker[new], minlength=int(self._marker.max()) + 1) >= FEWEST_NEW
        self._first[self._tested] = self._kept = np.where(new & ~moved[self._marker], 0, first)

    def _share(self, first: NDArray[np.int8]) -> float:
        lower = []
        for side, wrong in ((self._outside, -1), (~self._outside, 1)):
            known = first[side & (np.abs(first) == 1)]
            if len(known) < FEWEST_PIXELS:
                return 0.0
            share = float((known == wrong).mean())
            lower.append(share - STANDARD_ERRORS * np.sqrt(share * (1.0 - share) / len(known)))
        return max(min(lower), 0.0)


@njit(cache=True, nogil=True)
def _note_first_kernel(
    events: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]],
    tested: NDArray[np.bool_],
    first: NDArray[np.int8],
    last_us: NDArray[np.int64],
    net: NDArray[np.int32],
    share: float,
) -> None:  # pragma: no cover - compiled
    """Note the polarity, +1 or -1, or NO_ANSWER, of each tested pixel's first supported event.

    ``events`` holds columns, rows, whether the pixel rose towards a marker's level, and times, us;
    ``last_us`` ``(2, height, width)`` the time of each pixel's last event of either polarity, and
    ``net`` by how many more events it rose than fell. Both times are shortened to a ``share``.
    """
    x, y, rises, t = events
    height, width = tested.shape
    for i in range(x.size):
        column, row, side = np.int64(x[i]), np.int64(y[i]), 1 if rises[i] else 0
        if tested[row, column] and first[row, column] == 0:
            support = 0
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(column - 1, 0), min(column + 2, width)):
                    itself = r == row and c == column
                    if not itself and t[i] - last_us[side, r, c] < share * NEIGHBOUR_US:
                        support += 1
            if support >= NEIGHBOURS:
                other_us = last_us[1 - side, row, column]
                soon = other_us > min(last_us[side, row, column], t[i] - share * RETURN_US)
                if soon or (1 - 2 * side) * net[row, column] >= MOVED_EVENTS:
                    first[row, column] = NO_ANSWER
                else:
                    first[row, column] = 1 if rises[i] else -1
        last_us[side, row, column] = t[i]
        net[row, column] += 2 * side - 1
