"""One individual sensor: light on its pixels, mismatch, lookup tables and initial state."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from spikingtac.arrays import FloatArray
from spikingtac.sim.camera.config import CameraConfig, LightConfig
from spikingtac.sim.camera.pixels import (
    CHIP_DTYPE,
    DECAY_ENTRIES,
    EDGE_ENTRIES,
    LOG_ENTRIES,
    PIXEL_DTYPE,
)

# Coverage below which the tail of an edge is cut; at contrast 12.5 it is 1/40 of a threshold.
_EDGE_TAIL = 5e-4
_DECAY_MAX = 16.0  # Number of time constants after which an exponential is taken as zero (1e-7).
_PIXEL_BOX_VARIANCE_PX2 = 1.0 / 12.0
_TEXTURE_PERIOD_PX = 512
_PATTERN_LIMIT = 0.9  # Largest relative brightness of a pattern: the light stays positive.
_INSTANT_PER_US = 1e6  # Inverse time constant that stands for a photoreceptor without low-pass.
_HEADROOM = 1.05
DARKEST = 1e-4  # Lowest intensity that a pixel can see; white is 1.
_LOWEST_THRESHOLD = 0.2  # Floor of a threshold as a fraction of the nominal one (comparator).
_ROUNDING = 1e-6  # Relative margin: no difference is rounded onto its threshold in float32.


class Sensor(NamedTuple):
    """One individual sensor.

    Pixels that have not settled, or whose leak event is due, are updated although no marker moves
    over them.

    Attributes:
        pixels: ``(height, width)`` of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        chip: ``(1,)`` of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        unsettled: ``(n,)`` indices of the unsettled pixels. The first ``unsettled_count[0]`` are
            valid.
        unsettled_count: ``(1,)`` number of unsettled pixels.
        known_unsettled: ``(n,)`` 1 for each pixel that is known to be unsettled at the end of the
            interval. This byte saves a second access to the pixel's record.
        row_leak_due_us: ``(height,)`` lower bound of the pixels' ``leak_due_us`` in each row, us.
    """

    pixels: NDArray[Any]
    chip: NDArray[Any]
    unsettled: NDArray[np.int32]
    unsettled_count: NDArray[np.int64]
    known_unsettled: NDArray[np.uint8]
    row_leak_due_us: FloatArray


def make_sensor(
    config: CameraConfig, pattern: NDArray[np.float32], rng: np.random.Generator
) -> Sensor:
    """Draw an individual sensor.

    Args:
        config: Settings of the sensor.
        pattern: ``(p, p)`` relative brightness of the ground, periodic.
        rng: Source of mismatch, leak spread and the key of the random numbers.
    """
    (width, height), pixel = config.size, config.pixel
    pixels = np.zeros((height, width), PIXEL_DTYPE)
    pixels["index"] = np.arange(height * width).reshape(height, width)
    spread = pixel.mismatch * rng.standard_normal((2, height, width))
    for part, name in zip(spread, ("threshold_on", "threshold_off"), strict=True):
        nominal = getattr(pixel, name)
        pixels[name] = np.maximum(nominal + part, _LOWEST_THRESHOLD * nominal)
    decades = pixel.leak_spread * rng.standard_normal(pixels.shape)
    # A log-normal's mean exceeds its median; the configured rate is the mean over the array.
    mean = np.exp((pixel.leak_spread * np.log(10)) ** 2 / 2)
    pixels["mean_leak_per_us"] = pixels["threshold_on"] * pixel.leak_hz * 1e-6 * 10**decades / mean
    marker, ground = intensities(config.light)
    gain, stray = vignette(config.light, config.size), config.light.stray
    rows, columns = np.arange(height) % len(pattern), np.arange(width) % len(pattern)
    bare = gain * ground * (1 + pattern[rows[:, None], columns])
    pixels["ground_intensity"] = (bare + stray).clip(DARKEST, None)
    pixels["marker_increment"] = gain * marker + stray - pixels["ground_intensity"]
    covered = pixels["ground_intensity"] + pixels["marker_increment"]
    chip = np.zeros(1, CHIP_DTYPE)
    rate = _INSTANT_PER_US
    if pixel.bandwidth_hz is not None:
        rate = 2 * math.pi * pixel.bandwidth_hz * 1e-6
    chip["white_rate_per_us"] = rate / (1.0 + pixel.dark)
    for name in ("dark", "refractory_us", "latency_us", "jitter_us", "leak_jitter"):
        chip[name] = getattr(pixel, name)
    chip["key"] = rng.integers(0, 1 << 63)
    brightest = float(np.maximum(pixels["ground_intensity"], covered).max())
    _fill_lookup_tables(chip, config.light, brightest)
    count = height * width
    unsettled, known = np.empty(count, np.int32), np.zeros(count, np.uint8)
    return Sensor(pixels, chip, unsettled, np.zeros(1, np.int64), known, np.full(height, np.inf))


def _fill_lookup_tables(chip: NDArray[Any], light: LightConfig, brightest: float) -> None:
    """Fill the tables of the kernels; ``brightest`` is the highest intensity that occurs."""
    if light.edge == "gaussian":
        width_px = math.sqrt(light.blur_px**2 + _PIXEL_BOX_VARIANCE_PX2)
        reach_px = -width_px * float(ndtri(_EDGE_TAIL))
    else:
        width_px = light.blur_px
        reach_px = width_px * math.log(1 / _EDGE_TAIL - 1)
    offset = np.linspace(-reach_px, reach_px, EDGE_ENTRIES) / width_px
    profile = ndtr(offset) if light.edge == "gaussian" else 1 / (1 + np.exp(-offset))
    covered = ((profile - profile[0]) / (profile[-1] - profile[0])).clip(0, 1)
    chip["edge_coverage"][0] = covered
    chip["edge_half_width_px"] = reach_px
    chip["edge_per_px"] = (EDGE_ENTRIES - 1) / (2 * reach_px)
    top = _HEADROOM * brightest
    intensity = np.linspace(0, top, LOG_ENTRIES).clip(DARKEST, None)
    log = np.log(intensity)
    if light.linear_below > 0:  # a straight line; only differences of the result matter
        line = math.log(light.linear_below) + (intensity - light.linear_below) / light.linear_below
        log = np.where(intensity < light.linear_below, line, log)
    chip["log_intensity"][0] = log
    chip["log_per_unit"] = (LOG_ENTRIES - 1) / top
    chip["decay_table"][0] = np.exp(-np.linspace(0, _DECAY_MAX, DECAY_ENTRIES))
    chip["decay_table"][0, -1] = 0.0
    chip["decay_per_unit"] = (DECAY_ENTRIES - 1) / _DECAY_MAX


def intensities(light: LightConfig) -> tuple[float, float]:
    """Return the intensities of marker and ground. The brighter one is 1."""
    return (1.0, 1.0 / light.contrast) if light.contrast >= 1 else (light.contrast, 1.0)


def vignette(light: LightConfig, size: tuple[int, int]) -> FloatArray:
    """Return the fraction of the light that reaches each pixel, ``(height, width)``."""
    width, height = size
    x = np.arange(width) - (width - 1) / 2
    y = np.arange(height) - (height - 1) / 2
    square = (x[None, :] ** 2 + y[:, None] ** 2) / (max(size) / 2) ** 2
    return (1.0 - light.vignetting * square).clip(DARKEST, None)


def texture_field(light: LightConfig, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a periodic random pattern ``(512, 512)`` of mean 0 and of the configured rms.

    Without texture the result is a single 0, of shape ``(1, 1)``.
    """
    if light.texture <= 0:
        return np.zeros((1, 1), np.float32)
    noise = rng.standard_normal((_TEXTURE_PERIOD_PX, _TEXTURE_PERIOD_PX))
    frequency = np.fft.fftfreq(_TEXTURE_PERIOD_PX)
    square = frequency[:, None] ** 2 + frequency[None, :] ** 2
    smooth = np.exp(-2 * (math.pi * light.texture_px) ** 2 * square)
    field = np.fft.ifft2(np.fft.fft2(noise) * smooth).real
    field -= field.mean()
    pattern = (light.texture * field / field.std()).clip(-_PATTERN_LIMIT, _PATTERN_LIMIT)
    return pattern.astype(np.float32)


def settle_sensor(
    sensor: Sensor,
    coverage: NDArray[np.float32],
    now_us: float,
    history: str,
    rng: np.random.Generator,
) -> None:
    """Set every pixel to its steady state under an image.

    Args:
        sensor: Sensor whose state is overwritten.
        coverage: ``(height, width)`` fractions that the markers cover.
        now_us: Present time, us.
        history: ``rested``, ``random`` or ``fresh``; see
            :meth:`~spikingtac.sim.camera.event_camera.EventCamera.settle`.
        rng: Source of the initial references.
    """
    pixels, chip = sensor.pixels, sensor.chip[0]
    draw = rng.random(pixels.shape)
    pixels["intensity"] = pixels["ground_intensity"] + pixels["marker_increment"] * coverage
    place = np.arange(LOG_ENTRIES) / chip["log_per_unit"]
    pixels["target_level"] = np.interp(pixels["intensity"], place, chip["log_intensity"])
    pixels["level"] = pixels["target_level"]
    leak, threshold = pixels["mean_leak_per_us"], pixels["threshold_on"]
    pixels["leak_per_us"] = leak
    if history == "fresh":
        difference = np.zeros(pixels.shape)
    elif history == "random":
        difference = draw * (threshold + pixels["threshold_off"]) - pixels["threshold_off"]
    else:  # only the leak moves the references of a sensor at rest
        difference = np.where(leak > 0, draw * threshold, 0.0)
    pixels["difference"] = difference * (1 - _ROUNDING)
    pixels["updated_us"] = now_us
    pixels["dead_until_us"] = pixels["last_event_us"] = -np.inf
    pixels["queued"] = 0
    with np.errstate(divide="ignore"):
        wait_us = (threshold - pixels["difference"]) / leak.astype(np.float64)
    pixels["leak_due_us"] = now_us + wait_us
    sensor.unsettled_count[0] = 0
    sensor.row_leak_due_us[:] = pixels["leak_due_us"].min(axis=1)
