"""One individual sensor: light on its pixels, mismatch, lookup tables and initial state."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr, ndtri

from spikingtac.sim.camera.config import CameraConfig, LightConfig
from spikingtac.sim.camera.pixels import (
    CHIP_DTYPE,
    DECAY_ENTRIES,
    EDGE_ENTRIES,
    LOG_ENTRIES,
    PIXEL_DTYPE,
)
from spikingtac.types import FloatArray

# Coverage below which the tail of an edge is cut; at contrast 12.5 it is 1/40 of a threshold.
_EDGE_TAIL = 5e-4
_DECAY_MAX = 16.0  # Number of time constants after which an exponential is taken as zero (1e-7).
_PIXEL_BOX_VARIANCE_PX2 = 1.0 / 12.0
LEAK_SPREAD = 0.1  # Standard deviation of a pixel's leak rate, decades (as in v2e).
LEAK_JITTER = 0.1  # Relative standard deviation of that rate, drawn after each event (as in v2e).
_TEXTURE_PX = 5.0  # Correlation length of a textured ground, px.
_TEXTURE_LIMIT = 0.9  # Largest relative brightness of a texture: the light stays positive.
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
        row_leak_due_us: ``(height,)`` lower bound of the pixels' ``leak_due_us`` in each row, us.
    """

    pixels: NDArray[Any]
    chip: NDArray[Any]
    unsettled: NDArray[np.int32]
    unsettled_count: NDArray[np.int64]
    row_leak_due_us: FloatArray


def make_sensor(config: CameraConfig, size: tuple[int, int], rng: np.random.Generator) -> Sensor:
    """Draw an individual sensor.

    Args:
        config: Settings of the sensor.
        size: ``(width, height)``, px.
        rng: Source of mismatch, leak spread, texture and the key of the random numbers.
    """
    (width, height), pixel, light = size, config.pixel, config.light
    pixels = np.zeros((height, width), PIXEL_DTYPE)
    pixels["index"] = np.arange(height * width).reshape(height, width)
    spread = pixel.mismatch * rng.standard_normal((2, height, width))
    for part, name in zip(spread, ("threshold_on", "threshold_off"), strict=True):
        nominal = getattr(pixel, name)
        pixels[name] = np.maximum(nominal + part, _LOWEST_THRESHOLD * nominal)
    decades = LEAK_SPREAD * rng.standard_normal(pixels.shape)
    # A log-normal's mean exceeds its median; the configured rate is the mean over the array.
    mean = np.exp((LEAK_SPREAD * np.log(10)) ** 2 / 2)
    pixels["mean_leak_per_us"] = pixels["threshold_on"] * pixel.leak_hz * 1e-6 * 10**decades / mean
    # The brighter of marker and ground is 1; vignetting grows with the square of the radius.
    marker, ground = (1.0, 1.0 / light.contrast) if light.contrast >= 1 else (light.contrast, 1.0)
    x, y = np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2
    square = (x[None, :] ** 2 + y[:, None] ** 2) / (max(size) / 2) ** 2
    gain = (1.0 - light.vignetting * square).clip(DARKEST, None)
    bare = gain * ground
    if light.texture > 0:
        noise = rng.spawn(1)[0].standard_normal(bare.shape)
        field = gaussian_filter(noise, _TEXTURE_PX, mode="wrap")
        field *= light.texture / field.std()
        bare *= 1 + field.clip(-_TEXTURE_LIMIT, _TEXTURE_LIMIT)
    pixels["ground_intensity"] = (bare + light.stray).clip(DARKEST, None)
    pixels["marker_increment"] = gain * marker + light.stray - pixels["ground_intensity"]
    covered = pixels["ground_intensity"] + pixels["marker_increment"]
    chip = np.zeros(1, CHIP_DTYPE)
    corner_hz = pixel.bandwidth_hz
    rate = _INSTANT_PER_US if corner_hz is None else 2 * math.pi * corner_hz * 1e-6
    chip["white_rate_per_us"] = rate / (1.0 + light.linear_below)
    chip["dark"], chip["leak_jitter"] = light.linear_below, LEAK_JITTER
    for name in ("refractory_us", "latency_us", "jitter_us"):
        chip[name] = getattr(pixel, name)
    chip["key"] = rng.integers(0, 1 << 63)
    _fill_lookup_tables(chip, light, float(np.maximum(pixels["ground_intensity"], covered).max()))
    unsettled = np.empty(height * width, np.int32), np.zeros(1, np.int64)
    return Sensor(pixels, chip, *unsettled, np.full(height, np.inf))


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
    chip["edge_coverage"][0] = ((profile - profile[0]) / (profile[-1] - profile[0])).clip(0, 1)
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
