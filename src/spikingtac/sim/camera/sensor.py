"""One individual sensor: light on its pixels, mismatch, and their initial state.

Static light of the sensor: edge profile, vignetting, ground pattern and lookup tables.

Draw one individual sensor: mismatch, vignetting and the initial state of its pixels.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from spikingtac.sim.camera.config import CameraConfig, LightConfig, PixelConfig
from spikingtac.sim.camera.pixel_records import (
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

# Lowest and, negated, highest value of a pattern, so that the light never becomes negative.
_PATTERN_LOW = -0.9
_INSTANT_PER_US = 1e6  # Inverse time constant that stands for a photoreceptor without low-pass.
_HEADROOM = 1.05
DARKEST = 1e-4  # Lowest intensity that a pixel can see; white is 1.


def fill_lookup_tables(chip: NDArray[Any], light: LightConfig, brightest: float) -> None:
    """Fill the lookup tables of the kernels.

    Args:
        chip: ``(1,)`` array of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`, written to.
        light: Edge profile and front end.
        brightest: Highest intensity that occurs.
    """
    reach_px, profile = edge_profile(light)
    chip["edge_coverage"][0] = profile
    chip["edge_half_width_px"] = reach_px
    chip["edge_per_px"] = (EDGE_ENTRIES - 1) / (2 * reach_px)
    top = _HEADROOM * brightest
    intensity = np.linspace(0, top, LOG_ENTRIES).clip(DARKEST, None)
    chip["log_intensity"][0] = front_end(intensity, light.linear_below)
    chip["log_per_unit"] = (LOG_ENTRIES - 1) / top
    chip["decay_table"][0] = np.exp(-np.linspace(0, _DECAY_MAX, DECAY_ENTRIES))
    chip["decay_table"][0, -1] = 0.0
    chip["decay_per_unit"] = (DECAY_ENTRIES - 1) / _DECAY_MAX


def edge_profile(light: LightConfig) -> tuple[float, NDArray[np.float64]]:
    """Return the profile of a disc's edge.

    Returns:
        Half-width of the edge, px, and ``(EDGE_ENTRIES,)`` coverages from minus to plus that
        distance. Tails below 5e-4 are cut.
    """
    if light.edge == "gaussian":
        width_px = math.sqrt(light.blur_px**2 + _PIXEL_BOX_VARIANCE_PX2)
        reach_px = -width_px * float(ndtri(_EDGE_TAIL))
    else:
        width_px = light.blur_px
        reach_px = width_px * math.log(1 / _EDGE_TAIL - 1)
    offset = np.linspace(-reach_px, reach_px, EDGE_ENTRIES) / width_px
    profile = ndtr(offset) if light.edge == "gaussian" else 1 / (1 + np.exp(-offset))
    return reach_px, ((profile - profile[0]) / (profile[-1] - profile[0])).clip(0, 1)


def front_end(intensity: NDArray[np.float64], linear_below: float) -> NDArray[np.float64]:
    """Return the log response of the photoreceptor, with a straight line below ``linear_below``."""
    log = np.log(np.maximum(intensity, DARKEST))
    if linear_below <= 0:
        return log
    # A straight line to the origin of ln(I / smallest); only differences of the result matter.
    low = math.log(linear_below)
    line = low + (intensity - linear_below) / linear_below
    return np.where(intensity < linear_below, line, log)


def intensities(light: LightConfig) -> tuple[float, float]:
    """Return the intensities of marker and ground. The brighter one is 1."""
    return (1.0, 1.0 / light.contrast) if light.contrast >= 1 else (light.contrast, 1.0)


def vignette(light: LightConfig, size: tuple[int, int]) -> NDArray[np.float64]:
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
    return (
        (light.texture * field / field.std()).clip(_PATTERN_LOW, -_PATTERN_LOW).astype(np.float32)
    )


def inverse_time_constant_at_white(pixel: PixelConfig) -> float:
    """Return the inverse time constant of the photoreceptor at intensity 1, 1/us."""
    if pixel.bandwidth_hz is None:
        return _INSTANT_PER_US
    return 2 * math.pi * pixel.bandwidth_hz * 1e-6


# Lower limit of a threshold as a fraction of the nominal one (the comparator's floor).
_LOWEST_THRESHOLD = 0.2

# Relative margin that keeps a difference from being rounded onto its threshold in float32.
_ROUNDING = 1e-6


class PendingPixels(NamedTuple):
    """Pixels that must be updated although no marker moves over them.

    Attributes:
        unsettled: ``(n,)`` indices of the unsettled pixels. The first ``unsettled_count[0]`` are
            valid.
        unsettled_count: ``(1,)`` number of unsettled pixels.
        known_unsettled: ``(n,)`` 1 for each pixel that is known to be unsettled at the end of the
            interval. This byte saves a second access to the pixel's record.
        row_leak_due_us: ``(height,)`` lower bound of the pixels' ``leak_due_us`` in each row, us.
    """

    unsettled: NDArray[np.int32]
    unsettled_count: NDArray[np.int64]
    known_unsettled: NDArray[np.uint8]
    row_leak_due_us: NDArray[np.float64]


class Sensor(NamedTuple):
    """One individual sensor.

    Attributes:
        pixels: ``(height, width)`` of :data:`~spikingtac.sim.camera.pixel_records.PIXEL_DTYPE`.
        chip: ``(1,)`` of :data:`~spikingtac.sim.camera.pixel_records.CHIP_DTYPE`.
        pending: Pixels that must be updated although no marker moves over them.
    """

    pixels: NDArray[Any]
    chip: NDArray[Any]
    pending: PendingPixels


def make_sensor(
    config: CameraConfig, pattern: NDArray[np.float32], rng: np.random.Generator
) -> Sensor:
    """Draw an individual sensor.

    Args:
        config: Settings of the sensor.
        pattern: ``(p, p)`` relative brightness of the ground, periodic.
        rng: Source of mismatch, leak spread and the key of the random numbers.
    """
    width, height = config.size
    pixels = np.zeros((height, width), PIXEL_DTYPE)
    pixels["index"] = np.arange(height * width).reshape(height, width)
    _draw_mismatch(pixels, config.pixel, rng)
    brightest = _set_intensities(pixels, config, pattern)
    chip = np.zeros(1, CHIP_DTYPE)
    chip["white_rate_per_us"] = inverse_time_constant_at_white(config.pixel) / (
        1.0 + config.pixel.dark
    )
    for name in ("dark", "refractory_us", "latency_us", "jitter_us", "leak_jitter"):
        chip[name] = getattr(config.pixel, name)
    chip["key"] = rng.integers(0, 1 << 63)
    fill_lookup_tables(chip, config.light, brightest)
    pending = PendingPixels(
        unsettled=np.empty(height * width, np.int32),
        unsettled_count=np.zeros(1, np.int64),
        known_unsettled=np.zeros(height * width, np.uint8),
        row_leak_due_us=np.full(height, np.inf),
    )
    return Sensor(pixels=pixels, chip=chip, pending=pending)


def _draw_mismatch(pixels: NDArray[Any], pixel: PixelConfig, rng: np.random.Generator) -> None:
    spread = pixel.mismatch * rng.standard_normal((2, *pixels.shape))
    for name, nominal, part in (
        ("threshold_on", pixel.threshold_on, spread[0]),
        ("threshold_off", pixel.threshold_off, spread[1]),
    ):
        pixels[name] = np.maximum(nominal + part, _LOWEST_THRESHOLD * nominal)
    decades = pixel.leak_spread * rng.standard_normal(pixels.shape)
    # A log-normal's mean exceeds its median; the configured rate is the mean over the array.
    mean = np.exp((pixel.leak_spread * np.log(10)) ** 2 / 2)
    pixels["mean_leak_per_us"] = pixels["threshold_on"] * pixel.leak_hz * 1e-6 * 10**decades / mean


def _set_intensities(
    pixels: NDArray[Any], config: CameraConfig, pattern: NDArray[np.float32]
) -> float:
    """Set the light with and without a marker; return the highest intensity that can occur."""
    light = config.light
    height, width = pixels.shape
    marker, ground = intensities(light)
    gain = vignette(light, config.size)
    rows, columns = np.arange(height) % len(pattern), np.arange(width) % len(pattern)
    bare = gain * ground * (1 + pattern[rows[:, None], columns])
    pixels["ground_intensity"] = (bare + light.stray).clip(DARKEST, None)
    pixels["marker_increment"] = gain * marker + light.stray - pixels["ground_intensity"]
    top = np.maximum(
        pixels["ground_intensity"], pixels["ground_intensity"] + pixels["marker_increment"]
    ).max()
    return float(top)


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
            :meth:`~spikingtac.sim.camera.camera.EventCamera.settle`.
        rng: Source of the initial references.
    """
    pixels, chip = sensor.pixels, sensor.chip[0]
    draw = rng.random(pixels.shape)
    pixels["intensity"] = pixels["ground_intensity"] + pixels["marker_increment"] * coverage
    place = np.arange(len(chip["log_intensity"])) / chip["log_per_unit"]
    pixels["target_level"] = np.interp(pixels["intensity"], place, chip["log_intensity"])
    pixels["level"] = pixels["target_level"]
    pixels["leak_per_us"] = pixels["mean_leak_per_us"]
    if history == "fresh":
        difference = np.zeros(pixels.shape)
    elif history == "random":
        difference = (
            draw * (pixels["threshold_on"] + pixels["threshold_off"]) - pixels["threshold_off"]
        )
    else:  # only the leak moves the references of a sensor at rest
        difference = np.where(pixels["mean_leak_per_us"] > 0, draw * pixels["threshold_on"], 0.0)
    pixels["difference"] = difference * (1 - _ROUNDING)
    pixels["updated_us"] = now_us
    pixels["dead_until_us"] = pixels["last_event_us"] = -np.inf
    pixels["queued"] = 0
    with np.errstate(divide="ignore"):
        wait_us = (pixels["threshold_on"] - pixels["difference"]) / pixels[
            "mean_leak_per_us"
        ].astype(np.float64)
    pixels["leak_due_us"] = now_us + wait_us
    sensor.pending.unsettled_count[0] = 0
    sensor.pending.row_leak_due_us[:] = pixels["leak_due_us"].min(axis=1)
