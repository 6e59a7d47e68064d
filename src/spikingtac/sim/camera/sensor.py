"""Draw one individual sensor: mismatch, vignetting and the initial state of its pixels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig, PixelConfig
from spikingtac.sim.camera.light import (
    DARKEST,
    fill_lookup_tables,
    intensities,
    inverse_time_constant_at_white,
    vignette,
)
from spikingtac.sim.camera.pixel_records import CHIP_DTYPE, PIXEL_DTYPE

_LOWEST_THRESHOLD = 0.2
"""Lower limit of a threshold as a fraction of the nominal one (the comparator's floor)."""
_ROUNDING = 1e-6
"""Relative margin that keeps a difference from being rounded onto its threshold in float32."""


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
    return float(top) * (1 + light.flicker_depth)


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
