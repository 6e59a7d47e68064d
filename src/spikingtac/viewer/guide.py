"""What a calibration still lacks while events stream in, and what to do next, in words.

The calibration reads a recording forwards and backwards; a guide has seen only what came so far.
Levels begin at the ground and are added up as in
:mod:`spikingtac.markers.calibration.level_maps`. A pixel that a marker covers at rest shows it once
the marker has left it and has come back: exactly then its steps can be learned.
"""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.find_markers import (
    CalibrationConfig,
    DetectedMarkers,
    clutter,
    detect_markers,
)
from spikingtac.markers.calibration.layout import region
from spikingtac.markers.calibration.level_maps import SwingHistogram
from spikingtac.markers.calibration.recording import BIN_US, coded, quiet_spans, refuse_long
from spikingtac.types import EventPacket, FloatArray, Polarity

# A pixel has shown a marker when it came from the ground to this level: steps are estimated to 30
# %, so that most pixels reach the full level, not all.
SWUNG_LEVEL = 0.9

# A rise from ground to marker lasts no longer, us; noise that piles up takes longer. A rim 3 px
# wide passes in this time at 3 px/s.
SLOWEST_SWING_US = 1_000_000

FIRST_STEP = 0.2  # Share of a full swing of an event before any swing was seen: five a swing.

# Events after which the ratio of ON to OFF events is believed, and its bounds.
FEWEST_EVENTS, BALANCE = 2_000, (0.1, 10.0)

# The ways that a marker must go and come back from, to uncover its right, left, lower, upper side.
WAYS = ("left", "right", "up", "down")

LOOK_US = 500_000  # Sensor time between two searches for the markers, us: one takes some 20 ms.

# Share of its disc that has swung from which a marker has moved enough (noise and blurred rims
# leave some pixels of every disc below the level).
ENOUGH_SHARE = 0.7

CORE_SHARE = 0.8  # Share of its radius within which a disc is measured: the rim is blurred.

# Share of the markers that may lack motion while the guide says that all is there.
MOST_UNMOVED_SHARE = 0.05

# Rests without which a calibration is less sure: one before and one after the contacts (slides of
# the twin: 0.137 px mean error from one slide before the second rest, 0.110 px after it).
FEWEST_RESTS = 2

MOST_REGIONS = 3  # Regions that a sentence names.


@njit(cache=True)
def levels_kernel(
    code: NDArray[np.uint32],
    t_us: NDArray[np.int64],
    steps: NDArray[np.float32],
    maps: tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]],
) -> None:
    """Add each event to both maps, clipped to [0, 1], and note what rose from the ground in time.

    ``maps`` holds, for white and dark markers, the levels, which pixels swung, and when each left
    the ground last, ``(2, pixels)``.
    """
    level, swung, left_us = maps
    for i in range(len(code)):
        pixel = code[i] >> 1
        step = steps[0] if code[i] & 1 else -steps[1]
        for row in range(2):
            before = level[row, pixel]
            after = before + (step if row == 0 else -step)
            after = min(max(after, np.float32(0.0)), np.float32(1.0))
            level[row, pixel] = after
            if before <= 0.0 and after > 0.0:
                left_us[row, pixel] = t_us[i]
            if after >= SWUNG_LEVEL and t_us[i] - left_us[row, pixel] <= SLOWEST_SWING_US:
                swung[row, pixel] = True


def coverage(swung: NDArray[np.bool_], center_px: FloatArray, radius_px: float) -> FloatArray:
    """Return ``(m, 5)`` shares of each disc that swung: of all, right, left, below, above.

    Args:
        swung: ``(height, width)`` which pixels swung.
        center_px: ``(m, 2)`` where the markers rest, px; discs may reach over the border.
        radius_px: Their radius, px.
    """
    reach = int(np.ceil(radius_px)) + 1
    y, x = (axis.ravel() - reach for axis in np.indices((2 * reach + 1, 2 * reach + 1)))
    nearest = np.rint(center_px).astype(np.int64)
    column, row = nearest[:, :1] + x, nearest[:, 1:] + y
    dx, dy = column - center_px[:, :1], row - center_px[:, 1:]
    height, width = swung.shape
    inside = (np.hypot(dx, dy) <= radius_px) & (column >= 0) & (row >= 0)
    inside &= (column < width) & (row < height)
    seen = swung[row.clip(0, height - 1), column.clip(0, width - 1)]
    across = np.abs(dx) > np.abs(dy)
    quarters = (across & (dx > 0), across & (dx < 0), ~across & (dy > 0), ~across & (dy < 0))
    shares = [
        (inside & part & seen).sum(axis=1) / np.maximum((inside & part).sum(axis=1), 1)
        for part in (inside, *quarters)
    ]
    return np.column_stack(shares)


@dataclass(frozen=True, slots=True)
class GuideView:
    """The markers as far as they have appeared.

    Attributes:
        size: ``(width, height)``, px.
        t_us: Time of the last event that was taken.
        rests: How often the skin has rested.
        grid: ``(rows, columns)``, or None where the markers fill no rows.
        place_px: ``(m, 2)`` where each marker is seen or expected, px.
        radius_px: Typical radius of the markers, px.
        share: ``(m,)`` share of each disc that has been seen to change.
        sides: ``(m, 4)`` the same of its right, left, lower and upper quarter.
    """

    size: tuple[int, int]
    t_us: int = 0
    rests: int = 0
    grid: tuple[int, int] | None = None
    place_px: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    radius_px: float = 0.0
    share: FloatArray = field(default_factory=lambda: np.empty(0))
    sides: FloatArray = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def enough(self) -> NDArray[np.bool_]:
        """``(m,)`` which markers have moved enough."""
        return self.share >= ENOUGH_SHARE

    @property
    def ready(self) -> bool:
        """Whether a calibration from these events would know nearly every marker of the grid."""
        few = MOST_UNMOVED_SHARE * len(self.share)
        rested = self.rests >= FEWEST_RESTS
        return len(self.place_px) > 0 and rested and bool((~self.enough).sum() <= few)

    def advice(self) -> list[str]:
        """Return what to do next, the most pressing first; never empty."""
        if not len(self.place_px):
            return [
                "Slide a flat object or a finger over all of the skin, so that every marker moves "
                "by more than its diameter."
            ]
        lines, short = [], np.flatnonzero(~self.enough)
        if len(short):
            lacking = np.maximum(ENOUGH_SHARE - self.sides[short], 0.0).sum(axis=0)
            way = int(np.argmax(lacking))
            counts = Counter(region(place, self.size) for place in self.place_px[short])
            named = " and the ".join(name for name, _ in counts.most_common(MOST_REGIONS))
            where = "all over" if len(counts) > MOST_REGIONS else f"on the {named} of"
            needed = "marker needs" if len(short) == 1 else "markers need"
            lines.append(
                f"{len(short)} {needed} more motion: "
                f"slide {WAYS[way]} and back {WAYS[way ^ 1]} {where} the skin."
            )
        if self.rests < FEWEST_RESTS:
            lines.append("Take everything off the skin and wait half a second.")
        return lines or [f"All {len(self.place_px)} markers have moved enough: calibrate now."]

    def progress_line(self) -> str:
        """Return where a calibration stands and what it needs next, in one line."""
        shape = "no rows" if self.grid is None else "grid {}x{}".format(*self.grid)
        moved = f"{shape}, {int(self.enough.sum())} of {len(self.place_px)} markers moved enough"
        found = moved if len(self.place_px) else "no grid yet"
        return f"{self.t_us / 1e6:.1f} s: {found}. {self.advice()[0]}"


class CalibrationGuide:
    """Follows events and reports at any time which markers still have to move.

    Args:
        size: ``(width, height)`` of the sensor, px.
        config: What is known of the markers beforehand.
    """

    def __init__(self, size: tuple[int, int], config: CalibrationConfig | None = None) -> None:
        self._config = config or CalibrationConfig()
        self._size = size
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        width, height = self._size
        # Levels from 0 (ground) to 1 (marker), for white and for dark markers; which pixels came
        # from the ground to a marker; and when each left the ground last.
        self._level = np.zeros((2, height, width), np.float32)
        self._swung = np.zeros((2, height, width), np.bool_)
        self._left_us = np.zeros((2, height * width), np.int64)
        self._steps = np.full(2, FIRST_STEP, np.float32)
        self._swings = SwingHistogram(np.zeros(height * width, np.int64))
        self._on_per_off, self._events = 1.0, np.zeros(2, np.int64)
        self._seen: DetectedMarkers | None = None
        self._begin_us: int | None = None
        self._looked_us = self._t_us = self._rests = 0
        self._counts: list[int] = []
        self._resting = False
        self._polarity: Polarity = "white"

    def absorb(self, packet: EventPacket) -> None:
        """Take the next events, in order of time.

        Raises:
            CalibrationError: They lie more than 71 minutes behind the ones before.
        """
        packet = packet.sound()
        if self._begin_us is None:
            self._begin_us = self._looked_us = self._t_us = packet.t_start_us
        refuse_long(packet.t_end_us - self._t_us)
        self._events += np.bincount(packet.p, minlength=2)
        if self._events.sum() >= FEWEST_EVENTS:
            self._on_per_off = float(np.clip(self._events[1] / max(self._events[0], 1), *BALANCE))
        code = coded(packet)
        self._swings.absorb(code, self._on_per_off)
        maps = self._level.reshape(2, -1), self._swung.reshape(2, -1), self._left_us
        levels_kernel(code, packet.t, self._steps, maps)
        self._t_us = packet.t_end_us
        bins = (packet.t_end_us - self._begin_us) // BIN_US + 1
        self._counts += [0] * (bins - len(self._counts))
        found = np.unique((packet.t - self._begin_us) // BIN_US, return_counts=True)
        for number, count in zip(*(part.tolist() for part in found), strict=True):
            self._counts[number] += count
        if packet.t_end_us - self._looked_us >= LOOK_US:
            self._looked_us = packet.t_end_us
            self._look()

    @property
    def complete(self) -> bool:
        """Whether all is there and the skin rests again: a good moment to end a recording."""
        return self._resting and self._looked_us == self._t_us and self.view().ready

    @property
    def level(self) -> NDArray[np.float32]:
        """``(height, width)`` how bright each pixel is, from 0 (ground) to 1 (marker)."""
        return self._level[int(self._polarity == "dark")]

    def view(self) -> GuideView:
        """Return what is known now."""
        seen, about = self._seen, (self._size, self._t_us, self._rests)
        if seen is None:
            return GuideView(*about)
        swung = self._swung[int(self._polarity == "dark")]
        share = coverage(swung, seen.center_px, CORE_SHARE * seen.radius_px)
        known = seen.layout.shape, seen.center_px, seen.radius_px
        return GuideView(*about, *known, share[:, 0], share[:, 1:])

    def _look(self) -> None:
        if self._swings.counts.any():
            self._steps = self._swings.steps(self._on_per_off)[:, 0]
        counts = np.array(self._counts[:-1])  # the last bin has not ended
        spans = quiet_spans(counts)
        self._rests, self._resting = len(spans), bool((spans[-1:, 1] == len(counts)).any())
        polarity = self._config.polarity
        if polarity == "auto":
            lit = [clutter(level) for level in self._level]
            polarity = self._polarity if lit[0] == lit[1] else ("white", "dark")[np.argmin(lit)]
        if polarity != self._polarity:
            self._polarity, self._seen = polarity, None
        try:
            seen = detect_markers(self.level, self._config)
        except CalibrationError:
            return
        known, count = (
            0 if one is None else np.count_nonzero(one.layout.point >= 0)
            for one in (self._seen, seen)
        )
        # While markers move they are seen elsewhere; only what is new is worth that.
        if count > known or (self._resting and count >= 0.9 * known):
            self._seen = seen
