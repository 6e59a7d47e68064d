"""Brightness maps at chosen times, integrated from events alone.

Events are integrated with clipping between the ground (0) and a marker (1), forwards from the start
and backwards from the end. Clipping anchors the sum at both ends, so that neither noise nor unequal
thresholds make it drift. Both directions are averaged, since their errors are opposite.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.recording import (
    coded,
    moving_events,
    noise_rates,
    smoothed,
)
from spikingtac.state_map.graded import Array
from spikingtac.types import EventPacket, FloatArray

# Resolution and range of the histogram of brightness swings, in ON events.
BINS_PER_EVENT, LARGEST_SWING = 4, 100

# Hysteresis of a turning point, in events of the rarer polarity: a smaller reversal is noise.
TURN_EVENTS = 1.5

# Quantile of the swings, weighted by size, that estimates a full swing: most of the change in an
# image of moving discs consists of full swings (within 30 % on fifteen simulated sensors; it is the
# first estimate of a calibration).
SWING_QUANTILE = 0.5

# Bounds of the share of ON events among the events of motion; outside of them calibration is
# refused.
ON_SHARES = (0.02, 0.98)


def mean_steps(
    events: EventPacket, moving: NDArray[np.bool_], noise: FloatArray
) -> NDArray[np.float32]:
    """Return ``(2,)`` the mean steps of an ON and an OFF event, shares of a full swing.

    They are estimated from the balance of ON and OFF events and from the size of swings. Over a
    recording in which brightness returns to its start, all ON steps and all OFF steps have the same
    sum.

    Args:
        events: The recording.
        moving: ``bool[n]`` events that come while the skin moves.
        noise: ``(2,)`` ON and OFF events of the sensor's noise among them.

    Raises:
        CalibrationError: Nearly all events have one polarity.
    """
    code = coded(events)[moving]
    off, on = (np.bincount(code & 1, minlength=2) - noise[::-1]).clip(1.0)
    share = on / (on + off)
    if not ON_SHARES[0] <= share <= ON_SHARES[1]:
        raise CalibrationError(
            f"{share:.0%} of the events of motion are ON events, so brightness never comes back "
            "and no marker can be followed; check the camera's thresholds (biases)"
        )
    swings = SwingHistogram(np.zeros(events.pixels, np.int64))
    swings.absorb(code, on / off)
    return swings.steps(on / off)[:, 0]


class SwingHistogram:
    """Histogram of brightness swings between turning points, in ON events, per group of pixels.

    Args:
        group: ``(pixels,)`` number of each pixel's group.

    Attributes:
        counts: ``(groups, bins)`` swings by size, in bins of 1 / BINS_PER_EVENT.
    """

    def __init__(self, group: NDArray[np.int64]) -> None:
        self.counts = np.zeros((int(group.max()) + 1, LARGEST_SWING * BINS_PER_EVENT), np.int64)
        self._group, self._turns = group, np.zeros((4, len(group)), np.float32)

    def absorb(self, code: NDArray[np.uint32], on_per_off: float) -> None:
        """Add the next events, as :func:`.recording.coded` gives them."""
        swings_kernel(code, on_per_off, self._turns, self._group, self.counts)

    def steps(self, on_per_off: float) -> NDArray[np.float32]:
        """Return ``(2, groups)`` ON and OFF steps: a full swing is the SWING_QUANTILE of swings."""
        weight = np.cumsum(self.counts * np.arange(1, self.counts.shape[1] + 1), axis=1)
        full = (weight >= SWING_QUANTILE * weight[:, -1:]).argmax(axis=1) / BINS_PER_EVENT
        step = 1.0 / (np.maximum(full, 1.0) + 0.5)
        return np.array([step, step * on_per_off], np.float32).clip(max=1.0)


def level_maps(
    events: EventPacket,
    steps: NDArray[np.float32],
    index: NDArray[np.int64],
    start: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return ``(len(index), height, width)`` levels from 0 (ground) to 1 (marker).

    Args:
        events: The recording, markers brighter than the ground.
        steps: ``(2,)`` steps of an ON and an OFF event.
        index: Number of events before each map, increasing.
        start: ``(height, width)`` levels at the start of the recording.
    """
    level, code = start.ravel().copy(), coded(events)
    add_kernel(level, code, steps)
    maps = np.empty((len(index), events.pixels), np.float32)
    last = len(events)
    for row in range(len(index) - 1, -1, -1):
        _undo(level, code[index[row] : last], steps)
        last = int(index[row])
        maps[row] = level
    _undo(level, code[:last], steps)
    last = 0
    for row, at in enumerate(index):
        add_kernel(level, code[last:at], steps)
        last = int(at)
        maps[row] = 0.5 * (maps[row] + level)
    return maps.reshape(len(index), *events.shape)


def _undo(level: Array, code: Array, steps: Array) -> None:
    # Integrates backwards in time: the events in reverse order with inverted polarity.
    add_kernel(
        level, np.ascontiguousarray(code[::-1] ^ np.uint32(1)), np.ascontiguousarray(steps[::-1])
    )


@njit(cache=True)
def swings_kernel(code: Array, ratio: float, state: Array, group: Array, histogram: Array) -> None:
    """Count the swings of brightness between turning points into their group's histogram.

    ``state`` holds each pixel's brightness, the extreme since the last turning point, the value at
    that point, and the direction (1 up, -1 down, 0 not known).
    """
    turn = np.float32(TURN_EVENTS * max(1.0, ratio))
    for i in range(len(code)):
        pixel = code[i] >> 1
        state[0, pixel] += np.float32(1.0) if code[i] & 1 else np.float32(-ratio)
        direction = state[3, pixel]
        if direction == 0:
            if abs(state[0, pixel]) >= turn:
                state[3, pixel] = np.sign(state[0, pixel])
                state[1, pixel] = state[0, pixel]
            continue
        back = direction * (state[1, pixel] - state[0, pixel])
        if back < 0:
            state[1, pixel] = state[0, pixel]
        elif back >= turn:
            size = abs(state[1, pixel] - state[2, pixel])
            size_bin = min(int(size * BINS_PER_EVENT), histogram.shape[1] - 1)
            histogram[group[pixel], size_bin] += 1
            state[2, pixel] = state[1, pixel]
            state[1, pixel] = state[0, pixel]
            state[3, pixel] = -direction


@njit(cache=True)
def add_kernel(level: Array, code: Array, steps: Array) -> None:
    """Add each event's step to its pixel, clipped to [0, 1]."""
    on, off = steps[0], steps[1]
    for i in range(len(code)):
        pixel = code[i] >> 1
        if code[i] & 1:
            level[pixel] = min(level[pixel] + on, np.float32(1.0))
        else:
            level[pixel] = max(level[pixel] - off, np.float32(0.0))


# A pixel counts as active with so many events of motion, and so many times the noise expected from
# the rests.
FEWEST_EVENTS, OVER_NOISE = 1.0, 3.0

# Difference between maps integrated from dark and from bright above which the level is undecided:
# it is smaller where a pixel swung over more than half.
UNDECIDED = 0.5

# Distance from silent covered pixels at which pixels that swing a little are covered, too (four
# sensors: 5 and 8 are alike; with 3 a gap stays inside of large discs, without a bound feet of
# edges count).
GROWN_PX = 5

RIM_PX = 6  # Width of the rim around silent pixels that decides whether they are covered.

# Share of that rim, where its first level is decided, that begins bright around pixels covered by a
# marker.
# (Of sixteen simulated and recorded sensors, presses and slides, all keep their markers with 0.2
# to 0.5; at 0.1 ground between the tracks of slides was lit on five.)
LEAST_LIT = 0.3


def starting_levels(
    events: EventPacket, rests_us: NDArray[np.int64], steps: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return ``(height, width)`` levels at the start of the recording: 0 (ground) or 1 (marker).

    Args:
        events: The recording, markers brighter than the ground.
        rests_us: ``(rests, 2)`` begin and end of each rest, us.
        steps: ``(2,)`` mean steps of an ON and an OFF event.
    """
    from scipy import ndimage

    whole = coded(events)
    code = whole[moving_events(events, rests_us)]
    sent = np.bincount(code >> 1, minlength=events.pixels).reshape(events.shape)
    # Active pixels send more events than noise while the skin moves.
    moving_us = events.t_end_us - events.t_start_us - np.diff(rests_us, axis=1).sum()
    noise = noise_rates(events, rests_us).sum() * 1e-6 * moving_us
    fires = smoothed(sent.astype(np.float32)) > max(FEWEST_EVENTS, OVER_NOISE * noise)
    # First levels integrated backwards from a dark and from a bright map: undecided where they
    # differ.
    dark, bright = np.zeros(events.shape, np.float32), np.ones(events.shape, np.float32)
    for level in dark, bright:
        _undo(level.ravel(), whole, steps)
    undecided, lit = bright - dark > UNDECIDED, dark + bright > 1.0
    enclosed = np.asarray(ndimage.binary_fill_holes(fires), bool) & ~fires
    silent = np.zeros(events.shape, np.int32)
    ndimage.label(enclosed, output=silent)
    voters, parts = fires & ~undecided, int(silent.max()) + 1
    beside = np.asarray(ndimage.maximum_filter(silent, 2 * RIM_PX + 1))[voters]
    bright = np.bincount(beside, lit[voters], parts) > LEAST_LIT * np.bincount(beside, None, parts)
    covered = enclosed & bright[silent]
    # Undecided pixels began bright if their first events of motion are OFF.
    pixel, first = np.unique(code >> 1, return_index=True)
    fell = np.zeros(events.pixels, np.float32)
    fell[pixel] = np.where(code[first] & 1, -steps[0], steps[1])
    darkening = smoothed(fell.reshape(events.shape)) > 0.0
    around = covered | (fires & undecided & darkening)
    return ndimage.binary_dilation(covered, iterations=GROWN_PX, mask=around).astype(np.float32)
