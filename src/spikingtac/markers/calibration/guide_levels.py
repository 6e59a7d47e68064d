"""Which pixels have shown ground and marker so far, as events stream in.

The calibration reads a recording forwards and backwards; a guide has seen only what came so far.
Levels begin at the ground and are added up as in
:mod:`spikingtac.markers.calibration.level_maps`. A pixel that a marker covers at rest shows
it once the marker has left it and has come back: exactly then its steps can be learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.calibration.level_maps import (
    BINS_PER_EVENT,
    LARGEST_SWING,
    SWING_QUANTILE,
    MeanSteps,
    swings_kernel,
)
from spikingtac.types import EventPacket, Polarity

SWUNG_LEVEL = 0.9
"""A pixel has shown a marker when it came from the ground to this level. (Ours: the estimate of the
steps is good to 30 %, so that the full level is reached by most pixels, not by all.)"""

SLOWEST_SWING_US = 1_000_000
"""A rise from ground to marker lasts no longer, us; noise that piles up takes longer. (Ours: a rim
3 px wide passes in this time at 3 px/s.)"""

FIRST_STEP = 0.2
"""Share of a full swing of an event before any swing was seen (ours: five events a swing)."""

FEWEST_EVENTS = 2_000
"""Events after which the balance of ON and OFF is believed."""

BALANCE = (0.1, 10.0)
"""Bounds of the ratio of ON to OFF events; beyond them nearly all have one polarity."""

SIDES = ("right", "left", "lower", "upper")
"""Quarters of a disc, in the order of :attr:`Coverage.sides`."""

OPPOSITE = ("left", "right", "up", "down")
"""The way that a marker must go and come back from, to uncover each of :data:`SIDES`."""

WHITE, DARK = 0, 1
"""Rows of the maps: markers brighter than the ground, and darker."""


class StreamedLevels:
    """Levels of all pixels for white and for dark markers, and which of them swung.

    Attributes:
        size: ``(width, height)``, px.
        steps: What one event stands for, as far as it is known.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        pixels = size[0] * size[1]
        self.steps = MeanSteps(FIRST_STEP, FIRST_STEP)
        self._level = np.zeros((2, pixels), np.float32)
        self._swung = np.zeros((2, pixels), np.bool_)
        self._left_us = np.zeros((2, pixels), np.int64)
        self._turns = np.zeros((4, pixels), np.float32)
        self._histogram = np.zeros(LARGEST_SWING * BINS_PER_EVENT, np.int64)
        self._on = self._off = 0

    def absorb(self, packet: EventPacket) -> None:
        """Take the next events."""
        if not len(packet):
            return
        packet = packet.sound()
        on = int(np.count_nonzero(packet.p))
        self._on, self._off = self._on + on, self._off + len(packet) - on
        pixel = packet.y.astype(np.uint32) * np.uint32(self.size[0]) + packet.x
        code = pixel * np.uint32(2) + packet.p
        swings_kernel(code, self._ratio, self._turns, self._histogram)
        steps = np.array([self.steps.on, self.steps.off], np.float32)
        levels_kernel(code, packet.t, steps, (self._level, self._swung, self._left_us))

    def refresh(self) -> None:
        """Estimate the steps anew from the swings so far."""
        weight = self._histogram * np.arange(1, len(self._histogram) + 1)
        if not weight.sum():
            return
        reached = np.cumsum(weight) >= SWING_QUANTILE * weight.sum()
        step = 1.0 / (max(float(np.argmax(reached)) / BINS_PER_EVENT, 1.0) + 0.5)
        self.steps = MeanSteps(min(step, 1.0), min(step * self._ratio, 1.0))

    def level(self, polarity: Polarity) -> NDArray[np.float32]:
        """Return ``(height, width)`` levels from 0 (ground) to 1 (marker)."""
        return self._image(self._level, polarity)

    def swung(self, polarity: Polarity) -> NDArray[np.bool_]:
        """Return ``(height, width)``: which pixels came from the ground to a marker."""
        return self._image(self._swung, polarity)

    @property
    def _ratio(self) -> float:
        # ON events for each OFF event.
        if self._on + self._off < FEWEST_EVENTS:
            return 1.0
        return float(np.clip(self._on / max(self._off, 1), *BALANCE))

    def _image(self, rows: NDArray, polarity: Polarity) -> NDArray:
        row = WHITE if polarity == "white" else DARK
        return rows[row].reshape(self.size[1], self.size[0])


@njit(cache=True)
def levels_kernel(
    code: NDArray[np.uint32],
    t_us: NDArray[np.int64],
    steps: NDArray[np.float32],
    maps: tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]],
) -> None:
    """Add each event to both maps, clipped to [0, 1], and note what rose from the ground in time.

    ``maps`` holds, for white and dark markers, the levels, which pixels swung, and when each left
    the ground last.
    """
    level, swung, left_us = maps
    for i in range(len(code)):
        pixel = code[i] >> 1
        step = steps[0] if code[i] & 1 else -steps[1]
        for row in range(2):
            before = level[row, pixel]
            after = before + (step if row == WHITE else -step)
            after = min(max(after, np.float32(0.0)), np.float32(1.0))
            level[row, pixel] = after
            if before <= 0.0 and after > 0.0:
                left_us[row, pixel] = t_us[i]
            if after >= SWUNG_LEVEL and t_us[i] - left_us[row, pixel] <= SLOWEST_SWING_US:
                swung[row, pixel] = True


@dataclass(frozen=True, slots=True)
class Coverage:
    """What is known of the discs.

    Attributes:
        share: ``(m,)`` share of each disc's pixels that swung from ground to marker; all of them
            have once the marker has moved by its diameter, whichever way.
        sides: ``(m, 4)`` the same for its right, left, lower and upper quarter.
    """

    share: NDArray[np.float64]
    sides: NDArray[np.float64]


def coverage(
    swung: NDArray[np.bool_], center_px: NDArray[np.float64], radius_px: float
) -> Coverage:
    """Measure the discs of a grid.

    Args:
        swung: ``(height, width)`` which pixels swung.
        center_px: ``(m, 2)`` where the markers rest, px; discs may reach over the border.
        radius_px: Their radius, px.

    Example:
        >>> seen = np.zeros((9, 9), bool)
        >>> seen[:, 5:] = True  # the right half of a disc in the middle
        >>> coverage(seen, np.array([[4.0, 4.0]]), 3.0).sides.tolist()
        [[1.0, 0.0, 0.4, 0.4]]
    """
    reach = int(np.ceil(radius_px)) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    nearest = np.rint(center_px).astype(np.int64)
    column = nearest[:, 0, np.newaxis] + x.ravel()
    row = nearest[:, 1, np.newaxis] + y.ravel()
    dx, dy = column - center_px[:, :1], row - center_px[:, 1:]
    height, width = swung.shape
    inside = (np.hypot(dx, dy) <= radius_px) & (column >= 0) & (row >= 0)
    inside &= (column < width) & (row < height)
    seen = inside & swung[row.clip(0, height - 1), column.clip(0, width - 1)]
    across = np.abs(dx) > np.abs(dy)
    quarters = (across & (dx > 0), across & (dx < 0), ~across & (dy > 0), ~across & (dy < 0))
    sides = np.column_stack([_share(seen & part, inside & part) for part in quarters])
    return Coverage(_share(seen, inside), sides)


def _share(seen: NDArray[np.bool_], of: NDArray[np.bool_]) -> NDArray[np.float64]:
    return seen.sum(axis=1) / np.maximum(of.sum(axis=1), 1)
