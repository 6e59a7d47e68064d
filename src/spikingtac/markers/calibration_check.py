"""Does a recording come from the sensor that was calibrated?

A pixel just inside of a resting marker's rim can only fall at first, and one just outside can only
rise: whatever moves, however fast, the polarity of its first event tells on which side of the rim
it lies. Where the markers stand elsewhere than the calibration says, or have another size, many
pixels contradict it. Needs no tracker, so that one which has adapted itself to a wrong calibration
hides nothing.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.markers.graded.appearance import appearance_of, nearest_marker
from spikingtac.types import EventPacket

# Pixels of a resting marker's edge between these levels are not asked: they can rise and fall.
OUTSIDE_LEVEL, INSIDE_LEVEL = 0.1, 0.9

# Pixels are asked from there on for so far: farther ones the texture of the ground contradicts.
DEPTH_PX = 1.0

EDGE_REACH_PX = 8.0  # An edge is looked for this far to both sides of the rim.

# An event counts where so many of the eight pixels around sent one of the same polarity within
# this time before: noise has no company.
NEIGHBOUR_US, NEIGHBOURS = 20_000, 2

# Noted for a pixel that was on its way back: a slow motion, whose events have no company, had
# already brought it there. Its event before, or one in RETURN_US, was of the other polarity.
NO_ANSWER = 2

# A way back takes several events of a pixel, all within this time. (A touch ends in 0.1 to
# 0.3 s; noise of 0.1 Hz a pixel spoils one answer in ten.)
RETURN_US = 1_000_000

# Time between two judgements, by the stream's own clock: contradictions come with a motion's
# first pixels, and drown in those that fast strokes add.
TURN_US = 50_000

NOISE_TURNS = 10  # So many turns apart, what was noise is forgotten.

# A marker that shows fewer new pixels in half a second was at rest: they were noise, and are
# asked again. (Noise of 1 Hz a pixel brings 0.7.)
FEWEST_NEW = 3

# Pixels to both sides of the rims before the first judgement: 8 markers that moved by 2 px.
FEWEST_PIXELS = 100

# The share must exceed the limit by this: 95 % of the shares by chance do not.
STANDARD_ERRORS = 1.64

# Share of contradictions that is never suspicious. (200 simulated recordings with their own
# calibration stay below 0.032, the recorded sensor below 0.027; with that of another specimen 199
# exceed 0.06.)
MOST_CONTRADICTION = 0.06

# The check ends when this share of the pixels has answered: later first events follow motions
# that went unnoticed.
ENOUGH_SHARE = 0.5


class CalibrationCheck:
    """Judges a stream against a calibration, until it is sure or has seen enough.

    Args:
        calibration: What the stream is tracked with.

    Attributes:
        contradiction: Largest share so far of the pixels that contradict the calibration, on the
            side of the rims where it is less, less its standard errors; 0 until enough moved.
        limit: Share from which the calibration counts as that of another sensor.
        judged: True once enough pixels have answered to tell.
        ended: True when nothing will change any more.
    """

    def __init__(self, calibration: Calibration) -> None:
        owner = nearest_marker(calibration.reference_px, calibration.size)
        rim_px = _rim_distance_px(calibration, owner)
        inner_px, outer_px = _edge_px(calibration)[:, owner]
        asked = (rim_px > outer_px) & (rim_px < outer_px + DEPTH_PX)
        asked |= (rim_px < inner_px) & (rim_px > inner_px - DEPTH_PX)
        if calibration.marker_measured is not None:
            asked &= calibration.marker_measured[owner]
        self._marker = owner[asked].astype(np.int64)
        self._outside = rim_px[asked] > 0.0
        self._asked = asked
        self._first = np.zeros(asked.shape, np.int8)
        self._kept = np.zeros(len(self._marker), np.int8)
        self._turn = 0
        self._last_us = np.full((2, *asked.shape), np.iinfo(np.int64).min // 2)
        self._dark = calibration.polarity == "dark"
        self._filter = HotPixelFilter(calibration.hot_px, calibration.size)
        self._turn_us: int | None = None
        self.limit = MOST_CONTRADICTION
        self.contradiction, self.judged = 0.0, False
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
            "with the sensor's own); it is of another sensor, or something pressed when the "
            "recording began; calibrate this sensor: spikingtac calibrate RECORDING"
        )

    def absorb(self, packet: EventPacket) -> None:
        """Take in the next packet; any cutting of the stream gives the same judgement."""
        packet = self._filter.kept(packet)
        begin = 0
        while begin < len(packet) and not self.ended:
            if self._turn_us is None:
                self._turn_us = int(packet.t[0]) + TURN_US
            end = int(np.searchsorted(packet.t, self._turn_us))
            part = slice(begin, end)
            _note_first_kernel(
                (packet.x[part], packet.y[part], packet.p[part] != self._dark, packet.t[part]),
                self._asked,
                self._first,
                self._last_us,
            )
            if end < len(packet):
                self._judge()
                late_us = int(packet.t[end]) - self._turn_us
                self._turn_us += TURN_US * (1 + late_us // TURN_US)
            begin = end

    def finish(self) -> None:
        """Judge what came since the last turn."""
        if not self.ended:
            self._judge()

    def _judge(self) -> None:
        first = self._first[self._asked]
        self.contradiction = max(self.contradiction, self._share(first))
        self.judged |= np.count_nonzero(first) >= FEWEST_PIXELS
        self._turn += 1
        if self._turn % NOISE_TURNS == 0:
            self._forget_noise(first)
        self.ended = self.foreign or bool((self._kept != 0).mean() > ENOUGH_SHARE)

    def _forget_noise(self, first: NDArray[np.int8]) -> None:
        new = (first != 0) & (self._kept == 0)
        moved = np.bincount(self._marker[new], minlength=int(self._marker.max()) + 1) >= FEWEST_NEW
        noise = new & ~moved[self._marker]
        self._first[self._asked] = self._kept = np.where(noise, 0, first)

    def _share(self, first: NDArray[np.int8]) -> float:
        lower = []
        for side, wrong in ((self._outside, -1), (~self._outside, 1)):
            known = first[side & (np.abs(first) == 1)]
            if len(known) < FEWEST_PIXELS:
                return 0.0
            share = float((known == wrong).mean())
            lower.append(share - STANDARD_ERRORS * np.sqrt(share * (1.0 - share) / len(known)))
        return max(min(lower), 0.0)


def _rim_distance_px(calibration: Calibration, owner: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return ``(height, width)`` distances outside of the nearest marker's rim at rest, px."""
    y, x = np.mgrid[: owner.shape[0], : owner.shape[1]]
    center_px = calibration.reference_px[owner]
    return np.hypot(x - center_px[..., 0], y - center_px[..., 1]) - calibration.radius_px[owner]


def _edge_px(calibration: Calibration) -> NDArray[np.float64]:
    """Return ``(2, m)`` where each marker's edge begins and ends, px outside of its rim."""
    rim_px = np.linspace(-EDGE_REACH_PX, EDGE_REACH_PX, 1_601)
    levels = np.array([profile.level(rim_px) for profile in appearance_of(calibration).profiles])
    begin, end = (levels > INSIDE_LEVEL).sum(axis=1), (levels > OUTSIDE_LEVEL).sum(axis=1)
    return rim_px[np.clip([begin, end], 0, len(rim_px) - 1)]


@njit(cache=True, nogil=True)
def _note_first_kernel(
    events: tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]],
    asked: NDArray[np.bool_],
    first: NDArray[np.int8],
    last_us: NDArray[np.int64],
) -> None:  # pragma: no cover - compiled
    """Note each asked pixel's first event that has company: its polarity, +1 or -1, or NO_ANSWER.

    ``events`` are columns, rows, whether it became more like a marker, and times, us; ``last_us``
    ``(2, height, width)`` is the time of each pixel's last event of either polarity.
    """
    x, y, rises, t = events
    height, width = asked.shape
    for i in range(x.size):
        column, row, side = np.int64(x[i]), np.int64(y[i]), 1 if rises[i] else 0
        if asked[row, column] and first[row, column] == 0:
            company = 0
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(column - 1, 0), min(column + 2, width)):
                    itself = r == row and c == column
                    if not itself and t[i] - last_us[side, r, c] < NEIGHBOUR_US:
                        company += 1
            if company >= NEIGHBOURS:
                other_us = last_us[1 - side, row, column]
                if other_us > min(last_us[side, row, column], t[i] - RETURN_US):
                    first[row, column] = NO_ANSWER
                else:
                    first[row, column] = 1 if rises[i] else -1
        last_us[side, row, column] = t[i]
