"""How much of each marker's disc has been seen to change, and on which side."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.guide_levels import Coverage, StreamedLevels, coverage
from spikingtac.markers.calibration.lattice import LayoutKind
from spikingtac.markers.calibration.rests import (
    BIN_US,
    SHORTEST_REST_US,
    SMOOTH_BINS,
    quiet_limit,
)
from spikingtac.markers.calibration.sighting import (
    FindingConfig,
    Sighting,
    lit_share,
    sight_markers,
)
from spikingtac.types import EventPacket, Polarity

MOST_BINS = 1_200
"""Bins that are remembered: a minute of 50 ms each."""

NOISE_DEVIATIONS = 5.0
"""Quiet counts reach from 1.6 standard deviations of Poisson noise below their mean (the fifth
percentile) to some three above it."""


BIN_SUM_US = BIN_US * SMOOTH_BINS
"""Length of a bin, us: as long as the calibration sums over."""


class RestWatch:
    """Counts events in bins and separates rest from motion, as the calibration does afterwards.

    Attributes:
        rests: Rests so far, the present one included.
        resting: Whether the skin rests now.
    """

    def __init__(self) -> None:
        self._bins: deque[int] = deque(maxlen=MOST_BINS)
        self._begin_us: int | None = None
        self._count = 0
        self._quiet_us = 0
        self.rests = 0

    @property
    def resting(self) -> bool:
        """Whether the quiet has lasted for as long as a rest does."""
        return self._quiet_us >= SHORTEST_REST_US

    def absorb(self, packet: EventPacket) -> None:
        """Take the next events."""
        if self._begin_us is None:
            self._begin_us = packet.t_start_us
        first = 0
        while packet.t_end_us >= self._begin_us + BIN_SUM_US:
            last = int(np.searchsorted(packet.t, self._begin_us + BIN_SUM_US))
            self._end_bin(self._count + last - first)
            first, self._count = last, 0
            self._begin_us += BIN_SUM_US
            self._begin_us += self._silent_us(packet, first)
        self._count += len(packet) - first

    def _silent_us(self, packet: EventPacket, first: int) -> int:
        # A long silence is one rest; its bins are not counted one by one.
        assert self._begin_us is not None
        next_us = int(packet.t[first]) if first < len(packet) else packet.t_end_us
        skipped = (next_us - self._begin_us) // BIN_SUM_US
        if skipped < MOST_BINS:
            return 0
        self._bins.extend([0] * MOST_BINS)
        return int(skipped) * BIN_SUM_US

    def _end_bin(self, count: int) -> None:
        self._bins.append(count)
        was = self.resting
        self._quiet_us = (
            self._quiet_us + BIN_SUM_US
            if count <= quiet_limit(np.array(self._bins, float), NOISE_DEVIATIONS)
            else 0
        )
        self.rests += self.resting and not was


LOOK_US = 500_000
"""Sensor time between two looks for the grid, us (ours: a look takes some 20 ms)."""

ENOUGH_SHARE = 0.7
"""A marker has moved enough when this share of its disc has swung. (Ours: noise and blurred rims
leave some pixels of every disc below the level.)"""

CORE_SHARE = 0.8
"""Radius within which the disc is measured, as a share of its own: the rim is blurred."""

DOUBTFUL_SHARE = 0.4
"""Below this share the calibration will hardly measure the marker."""

MOST_UNMOVED_SHARE = 0.05
"""Share of the markers that may lack motion while the guide says that all is there."""


FEWEST_RESTS = 2
"""Rests without which a calibration is less sure: one before and one after the contacts. (On the
twin's slides, simulated: 0.137 px mean error from one slide before the second rest, 0.110 px after
it, 0.096 px from all of six seconds.)"""


@dataclass(frozen=True, slots=True)
class GuideView:
    """The markers as far as they have appeared.

    Attributes:
        size: ``(width, height)``, px.
        t_us: Time of the last event that was taken.
        grid: ``(rows, columns)``, or None where the markers fill no rows.
        place_px: ``(m, 2)`` where each marker is seen or expected, px.
        radius_px: Typical radius of the markers, px.
        share: ``(m,)`` share of each disc that has been seen to change.
        sides: ``(m, 4)`` the same by
            :data:`~spikingtac.markers.calibration.guide_levels.SIDES`.
        rests: How often the skin has rested.
        resting: Whether it rests now.
        polarity: White or dark markers.
        missing: Why there is no grid, or an empty string.
    """

    size: tuple[int, int]
    t_us: int = 0
    grid: tuple[int, int] | None = None
    place_px: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    radius_px: float = 0.0
    share: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    sides: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    rests: int = 0
    resting: bool = False
    polarity: Polarity = "white"
    missing: str = ""

    @property
    def enough(self) -> NDArray[np.bool_]:
        """``(m,)`` which markers have moved enough."""
        return self.share >= ENOUGH_SHARE

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """``(m,)`` which markers the calibration would hardly measure."""
        return self.share < DOUBTFUL_SHARE

    @property
    def ready(self) -> bool:
        """Whether a calibration from these events would know nearly every marker of the grid."""
        few = MOST_UNMOVED_SHARE * len(self.share)
        rested = self.rests >= FEWEST_RESTS
        return len(self.place_px) > 0 and rested and bool((~self.enough).sum() <= few)


class CalibrationGuide:
    """Follows events and reports at any time which markers still have to move.

    Args:
        size: ``(width, height)`` of the sensor, px.
        grid: ``(rows, columns)``, or None to find it.
        polarity: White or dark markers, or "auto" to find out.
        layout: What the markers are; "auto" tells grids from staggered rows.
    """

    def __init__(
        self,
        size: tuple[int, int],
        grid: tuple[int, int] | None = None,
        polarity: Literal["auto"] | Polarity = "auto",
        layout: LayoutKind = "auto",
    ) -> None:
        self._config = FindingConfig(grid=grid, polarity=polarity, layout=layout)
        self._size = size
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._levels, self._rests = StreamedLevels(self._size), RestWatch()
        self._sighting: Sighting | None = None
        self._known = 0
        self._looked_us: int | None = None
        self._t_us = 0
        self._polarity: Polarity = "white"
        self._missing = "nothing has moved yet"

    def absorb(self, packet: EventPacket) -> None:
        """Take the next events, in order of time."""
        self._levels.absorb(packet)
        self._rests.absorb(packet)
        self._t_us = packet.t_end_us
        if self._looked_us is None:
            self._looked_us = packet.t_start_us
        if packet.t_end_us - self._looked_us >= LOOK_US:
            self._looked_us = packet.t_end_us
            self._look()

    @property
    def complete(self) -> bool:
        """Whether all is there and the skin rests again: a good moment to end a recording."""
        return self._rests.resting and self._looked_us == self._t_us and self.view().ready

    @property
    def level(self) -> NDArray[np.float32]:
        """``(height, width)`` how bright each pixel is, from 0 (ground) to 1 (marker)."""
        return self._levels.level(self._polarity)

    def view(self) -> GuideView:
        """Return what is known now."""
        seen = self._sighting
        if seen is None:
            return GuideView(
                self._size,
                self._t_us,
                rests=self._rests.rests,
                resting=self._rests.resting,
                missing=self._missing,
            )
        known = self._coverage(seen)
        return GuideView(
            self._size,
            self._t_us,
            seen.layout.shape,
            seen.center_px,
            seen.radius_px,
            known.share,
            known.sides,
            self._rests.rests,
            self._rests.resting,
            self._polarity,
        )

    def _coverage(self, seen: Sighting) -> Coverage:
        swung = self._levels.swung(self._polarity)
        return coverage(swung, seen.center_px, CORE_SHARE * seen.radius_px)

    def _look(self) -> None:
        self._levels.refresh()
        polarity = self._judged_polarity()
        if polarity != self._polarity:
            self._polarity, self._sighting, self._known = polarity, None, 0
        config = self._config
        try:
            seen = sight_markers(self.level, self._size, config)
        except CalibrationError as error:
            self._missing = str(error)
            return
        found = len(seen.layout.point) - len(seen.layout.missing)
        # While markers move they are seen elsewhere; only what is new is worth that.
        if found > self._known or (self._rests.resting and found >= 0.9 * self._known):
            self._sighting, self._known = seen, found

    def _judged_polarity(self) -> Polarity:
        if self._config.polarity != "auto":
            return self._config.polarity
        lit: dict[Polarity, float] = {}
        for polarity in ("white", "dark"):
            lit[polarity] = lit_share(self._levels.level(polarity)[np.newaxis])
        return min(lit, key=lambda name: (lit[name], name != self._polarity))
