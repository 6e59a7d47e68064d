"""Background activity of the sensor: Poisson events over the whole array, and hot pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import BackgroundConfig
from spikingtac.sim.camera.pixel_records import KEY_SHIFT
from spikingtac.sim.camera.random import uniform_kernel


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
    hot_cumulative: NDArray[np.float64]
    polarity: NDArray[np.uint8]
    next_us: NDArray[np.float64]
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
    low, high = math.log(config.hot_min_hz), math.log(config.hot_max_hz)
    hot_hz = np.exp(rng.uniform(low, high, hot))
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
        source.next_us[0] = now_us - math.log(uniform_kernel(source.key, np.uint64(0))) / (
            source.rate_per_us
        )


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
            nearest, end = 0, source.hot_pixel.shape[0] - 1
            while (
                nearest < end
            ):  # np.searchsorted, whose parts take longer to compile than all of this
                middle = (nearest + end) // 2
                if source.hot_cumulative[middle] < rest:
                    nearest = middle + 1
                else:
                    end = middle
            i = source.hot_pixel[nearest]
        source.polarity[i] ^= np.uint8(1)
        timestamp_us = np.int64(source.next_us[0])
        out[n] = (timestamp_us << KEY_SHIFT) | (np.int64(i) << 1) | np.int64(source.polarity[i])
        out[0] = n
        wait = -math.log(uniform_kernel(source.key, draw + np.uint64(2)))
        source.next_us[0] += wait / source.rate_per_us
    return True
