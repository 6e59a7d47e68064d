"""Maps of brightness at chosen times, from nothing but events.

Events are added up and clipped between the ground (0) and a marker (1), forwards from the start and
backwards from the end. Clipping anchors the sum at both ends, so that neither noise nor pixels of
unlike thresholds make it drift. Both directions are averaged, since their errors are opposed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.buffered_events import BufferedEvents

BINS_PER_EVENT, LARGEST_SWING = 4, 100
"""Resolution and range of the histogram of brightness swings, in ON events."""

TURN_EVENTS = 1.5
"""A swing ends when brightness turns back by this many events of the rarer polarity: less is
noise."""

SWING_QUANTILE = 0.5
"""Quantile of the swings, weighted with their size, that stands for a full one: most of the
change in a picture of moving discs is made of full swings (ours: within 30 % on fifteen simulated
sensors; it only starts the estimate of :mod:`spikingtac.markers.calibration.swings`)."""

ON_SHARES = (0.02, 0.98)
"""Shares of ON events among the events of motion between which a calibration is tried."""


@dataclass(frozen=True, slots=True)
class MeanSteps:
    """What one event of the sensor stands for on the average, in shares of a full swing.

    Attributes:
        on: Share of an ON event.
        off: Share of an OFF event.
    """

    on: float
    off: float

    def inverted(self) -> MeanSteps:
        """Return the steps for swapped polarities."""
        return MeanSteps(self.off, self.on)


def mean_steps(events: BufferedEvents, moving: NDArray[np.bool_]) -> MeanSteps:
    """Estimate the steps from the balance of ON and OFF events and from the size of swings.

    Over a recording in which brightness comes back to where it was, the sum of all ON steps equals
    that of all OFF steps.

    Args:
        events: The recording.
        moving: ``bool[n]`` events that belong to motion, not to the sensor's noise.

    Raises:
        CalibrationError: Nearly all events have one polarity.
    """
    on = int(np.count_nonzero(events.code[moving] & 1))
    off = int(np.count_nonzero(moving)) - on
    share = on / max(on + off, 1)
    if not ON_SHARES[0] <= share <= ON_SHARES[1]:
        raise CalibrationError(
            f"{share:.0%} of the events of motion are ON events, so brightness never comes back "
            "and no marker can be followed; check the camera's thresholds (biases)"
        )
    ratio = on / off
    histogram = np.zeros(LARGEST_SWING * BINS_PER_EVENT, np.int64)
    swings_kernel(events.code, ratio, np.zeros((4, events.pixels), np.float32), histogram)
    weight = histogram * np.arange(1, len(histogram) + 1)
    reached = np.cumsum(weight) >= SWING_QUANTILE * weight.sum()
    swing = max(float(np.argmax(reached)) / BINS_PER_EVENT, 1.0)
    step = 1.0 / (swing + 0.5)
    return MeanSteps(min(step, 1.0), min(step * ratio, 1.0))


def level_maps(
    events: BufferedEvents,
    steps: MeanSteps,
    index: NDArray[np.int64],
    start: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return ``(len(index), height, width)`` levels from 0 (ground) to 1 (marker).

    Args:
        events: The recording, markers brighter than the ground.
        steps: What one event stands for.
        index: How many events came before each map, increasing.
        start: ``(height, width)`` levels when the recording begins.
    """
    both = np.array([steps.on, steps.off], np.float32)
    level = start.ravel().copy()
    add_kernel(level, events.code, both)
    maps = np.empty((len(index), events.pixels), np.float32)
    last = len(events)
    for row in range(len(index) - 1, -1, -1):
        undo_kernel(level, events.code[index[row] : last], both)
        last = int(index[row])
        maps[row] = level
    undo_kernel(level, events.code[:last], both)
    last = 0
    for row, at in enumerate(index):
        add_kernel(level, events.code[last:at], both)
        last = int(at)
        maps[row] = 0.5 * (maps[row] + level)
    return maps.reshape(len(index), *events.shape)


@njit(cache=True)
def swings_kernel(
    code: NDArray[np.uint32],
    ratio: float,
    state: NDArray[np.float32],
    histogram: NDArray[np.int64],
) -> None:
    """Count how far brightness goes between two turns, pixel by pixel.

    ``state`` holds for each pixel its brightness, the outermost value since the last turn, the
    value at that turn, and the direction (1 up, -1 down, 0 not known).
    """
    turn = np.float32(TURN_EVENTS * max(1.0, ratio))
    for i in range(len(code)):
        pixel = code[i] >> 1
        state[0, pixel] += np.float32(1.0) if code[i] & 1 else np.float32(-ratio)
        way = state[3, pixel]
        if way == 0:
            if abs(state[0, pixel]) >= turn:
                state[3, pixel] = np.sign(state[0, pixel])
                state[1, pixel] = state[0, pixel]
            continue
        back = way * (state[1, pixel] - state[0, pixel])
        if back < 0:
            state[1, pixel] = state[0, pixel]
        elif back >= turn:
            size = abs(state[1, pixel] - state[2, pixel])
            histogram[min(int(size * BINS_PER_EVENT), len(histogram) - 1)] += 1
            state[2, pixel] = state[1, pixel]
            state[1, pixel] = state[0, pixel]
            state[3, pixel] = -way


@njit(cache=True)
def add_kernel(
    level: NDArray[np.float32], code: NDArray[np.uint32], steps: NDArray[np.float32]
) -> None:
    """Add each event's step to its pixel, clipped to [0, 1]."""
    on, off = steps[0], steps[1]
    for i in range(len(code)):
        pixel = code[i] >> 1
        if code[i] & 1:
            level[pixel] = min(level[pixel] + on, np.float32(1.0))
        else:
            level[pixel] = max(level[pixel] - off, np.float32(0.0))


@njit(cache=True)
def undo_kernel(
    level: NDArray[np.float32], code: NDArray[np.uint32], steps: NDArray[np.float32]
) -> None:
    """Take each event's step back, last event first, clipped to [0, 1]."""
    on, off = steps[0], steps[1]
    for back in range(1, len(code) + 1):
        i = len(code) - back
        pixel = code[i] >> 1
        if code[i] & 1:
            level[pixel] = max(level[pixel] - on, np.float32(0.0))
        else:
            level[pixel] = min(level[pixel] + off, np.float32(1.0))
