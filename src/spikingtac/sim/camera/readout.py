"""Readout of the sensor, and the background events that no motion causes.

Background: Poisson events over the whole array, and hot pixels. Readout: order of time, rate limit
of the arbiter, and random loss.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import BackgroundConfig, ReadoutConfig
from spikingtac.sim.camera.pixels import KEY_SHIFT, uniform_kernel
from spikingtac.types import EventPacket, FloatArray, LossCounters

# Lowest and highest rate of a hot pixel, Hz; log-uniform in between (contract.md).
HOT_HZ = (10.0, 500.0)


class NoiseSource(NamedTuple):
    """One Poisson process for the whole array. The pixel is drawn with each event.

    Attributes:
        rate_per_us: Rate of the whole array, 1/us.
        background_fraction: Fraction of the rate that is spread evenly over all pixels.
        hot_pixel: ``(h,)`` indices of the hot pixels.
        hot_cumulative: ``(h,)`` cumulative fractions of the rate of the hot pixels.
        polarity: ``(n,)`` polarity of each pixel's next event; the polarities alternate.
        next_us: ``(1,)`` time of the next event, us.
        drawn: ``(1,)`` number of events drawn so far.
        key: Key of the random numbers.
    """

    rate_per_us: float
    background_fraction: float
    hot_pixel: NDArray[np.int64]
    hot_cumulative: FloatArray
    polarity: NDArray[np.uint8]
    next_us: FloatArray
    drawn: NDArray[np.uint64]
    key: np.uint64


def make_noise(config: BackgroundConfig, pixels: int, rng: np.random.Generator) -> NoiseSource:
    """Draw the hot pixels and set up the process. :func:`start_noise` starts it.

    Args:
        config: Rates.
        pixels: Number of pixels of the sensor.
        rng: Source of the hot pixels, of their rates and of the key.
    """
    hot = round(config.hot_fraction * pixels)
    hot_pixel = np.sort(rng.choice(pixels, hot, replace=False)).astype(np.int64)
    hot_hz = np.exp(rng.uniform(math.log(HOT_HZ[0]), math.log(HOT_HZ[1]), hot))
    background_hz = config.rate_hz * pixels
    total_hz = background_hz + hot_hz.sum()
    return NoiseSource(
        rate_per_us=float(total_hz * 1e-6),
        background_fraction=float(background_hz / total_hz) if total_hz > 0 else 1.0,
        hot_pixel=hot_pixel,
        hot_cumulative=np.cumsum(hot_hz) / max(float(hot_hz.sum()), 1e-30),
        polarity=rng.integers(0, 2, pixels, dtype=np.uint8),
        next_us=np.full(1, np.inf),
        drawn=np.zeros(1, np.uint64),
        key=np.uint64(rng.integers(0, 1 << 63)),
    )


def start_noise(source: NoiseSource, now_us: float) -> None:
    """Draw the time of the first event after ``now_us``."""
    source.next_us[0] = np.inf
    if source.rate_per_us > 0:
        source.drawn[0] = 0
        wait = -math.log(uniform_kernel(source.key, np.uint64(0)))
        source.next_us[0] = now_us + wait / source.rate_per_us


@njit(cache=True, nogil=True, error_model="numpy")
def background_events_kernel(source: NoiseSource, until_us: float, out: NDArray[np.int64]) -> bool:
    """Append the events before ``until_us``.

    Args:
        source: Process, advanced in place.
        until_us: End of the interval, us.
        out: ``out[0]`` counts the events, whose keys follow.

    Returns:
        False if the buffer is full before the end of the interval. Empty it and call again.
    """
    pixels = source.polarity.shape[0]
    while source.next_us[0] < until_us:
        n = out[0] + 1
        if n >= out.shape[0]:
            return False
        draw = source.drawn[0] * np.uint64(2)
        source.drawn[0] += np.uint64(1)
        place = uniform_kernel(source.key, draw + np.uint64(1))
        if place < source.background_fraction:
            i = min(int(place / source.background_fraction * pixels), pixels - 1)
        else:
            rest = (place - source.background_fraction) / (1.0 - source.background_fraction)
            nearest = np.searchsorted(source.hot_cumulative, rest)
            i = source.hot_pixel[min(nearest, len(source.hot_pixel) - 1)]
        source.polarity[i] ^= np.uint8(1)
        timestamp_us = np.int64(source.next_us[0])
        out[n] = (timestamp_us << KEY_SHIFT) | (np.int64(i) << 1) | np.int64(source.polarity[i])
        out[0] = n
        wait = -math.log(uniform_kernel(source.key, draw + np.uint64(2)))
        source.next_us[0] += wait / source.rate_per_us
    return True


_PIXEL_BITS = (1 << KEY_SHIFT) - 1
BACKLOG_US = 1000.0  # Longest wait for the arbiter, us. Longer ones are dropped and counted.


class Arbiter(NamedTuple):
    """A server that passes one event at a time, in order of time.

    Attributes:
        event_us: Service time of an event, us.
        loss: Fraction of the events that is lost at random behind the server.
        free_us: ``(1,)`` time from which the server is free, us.
        served: ``(1,)`` number of events that the server has passed.
        key: Key of the random numbers.
    """

    event_us: float
    loss: float
    free_us: FloatArray
    served: NDArray[np.uint64]
    key: np.uint64


@njit(cache=True, nogil=True, error_model="numpy")
def arbitrate_kernel(
    keys: NDArray[np.int64], arbiter: Arbiter, out: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Pass events through the arbiter.

    Args:
        keys: ``(n,)`` sorted keys.
        arbiter: Arbiter whose state is advanced.
        out: ``(n,)`` receives the keys of the remaining events, with new time stamps, in order.

    Returns:
        Numbers of events kept, dropped because of their wait, and lost at random.
    """
    kept = dropped = lost = 0
    for key in keys:
        requested_us = float(key >> KEY_SHIFT)
        start_us = max(requested_us, arbiter.free_us[0])
        if start_us - requested_us > BACKLOG_US:
            dropped += 1
            continue
        arbiter.free_us[0] = start_us + arbiter.event_us
        draw = uniform_kernel(arbiter.key, arbiter.served[0])
        arbiter.served[0] += np.uint64(1)
        if draw < arbiter.loss:
            lost += 1
            continue
        out[kept] = (np.int64(math.floor(start_us)) << KEY_SHIFT) | (key & _PIXEL_BITS)
        kept += 1
    return kept, dropped, lost


class Readout:
    """Collects the events of the pixels and returns them in order of time.

    An event that latency or arbiter delay beyond an interval is returned with a later interval.

    Args:
        config: Rate limit and losses.
        size: ``(width, height)`` of the sensor, px.
        key: Key of the random loss.

    Attributes:
        losses: Counters ``readout_overflow`` and ``readout_loss``.
    """

    def __init__(self, config: ReadoutConfig, size: tuple[int, int], key: int) -> None:
        event_us = 0.0 if config.cap_mev_s is None else 1.0 / config.cap_mev_s
        state = np.full(1, -np.inf), np.zeros(1, np.uint64), np.uint64(key)
        self._arbiter = Arbiter(event_us, config.loss, *state)
        self._size, self.losses = size, LossCounters()
        self.reset(0)

    def reset(self, now_us: int) -> None:
        """Drop all pending events and start again at ``now_us``."""
        self._since_us = now_us
        self._pending = self._delayed = np.empty(0, np.int64)
        self._arbiter.free_us[0] = -np.inf

    def collect(self, keys: NDArray[np.int64]) -> None:
        """Add the keys of events, in any order. The keys are copied."""
        self._pending = np.concatenate([self._pending, keys])

    def release(self, until_us: int) -> NDArray[np.int64]:
        """Return the keys of all events with a time stamp before ``until_us``, sorted by time."""
        pending = self._pending
        pending.sort()
        early = int(np.searchsorted(pending, self._since_us << KEY_SHIFT))
        if early:  # rounding put them before their interval
            pending[:early] = (self._since_us << KEY_SHIFT) | (pending[:early] & _PIXEL_BITS)
            pending.sort()
        self._since_us = until_us
        ready = int(np.searchsorted(pending, until_us << KEY_SHIFT))
        self._pending = pending[ready:]
        if self._arbiter.event_us == self._arbiter.loss == 0.0:
            return pending[:ready]
        served = np.empty(ready, np.int64)
        kept, dropped, lost = arbitrate_kernel(pending[:ready], self._arbiter, served)
        self.losses.add("readout_overflow", int(dropped))
        self.losses.add("readout_loss", int(lost))
        passed = np.concatenate([self._delayed, served[:kept]])
        # The arbiter keeps the order of time, so one cut separates the delayed events.
        out = int(np.searchsorted(passed, until_us << KEY_SHIFT))
        self._delayed = passed[out:]
        return passed[:out]

    def packet(self, parts: list[NDArray[np.int64]], t_start_us: int, t_end_us: int) -> EventPacket:
        """Return released keys as a packet of the span from ``t_start_us`` to ``t_end_us``."""
        keys = np.concatenate(parts) if parts else np.empty(0, np.int64)
        y, x = np.divmod((keys & _PIXEL_BITS) >> 1, self._size[0])
        place, on = (x.astype(np.uint16), y.astype(np.uint16)), (keys & 1).astype(np.bool_)
        return EventPacket(*place, on, keys >> KEY_SHIFT, t_start_us, t_end_us, self._size)
