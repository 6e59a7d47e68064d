"""Make one specimen of the sensor: its mismatch, its vignetting, its pixels' first state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig, PixelConfig
from spikingtac.sim.camera.light import (
    DARKEST,
    fill_tables,
    intensities,
    rate_at_white,
    vignette,
)
from spikingtac.sim.camera.pixels import CHIP_DTYPE, PIXEL_DTYPE

_LOWEST_THRESHOLD = 0.2
"""Share of the nominal threshold below which mismatch does not go (the comparator's own floor)."""
_ROUNDING = 1e-6
"""Keeps a gap from being rounded onto its threshold in float32."""


class Agenda(NamedTuple):
    """Which pixels need attention although no marker moves over them.

    Attributes:
        waiting: Indices of the unsettled pixels; the first ``listed[0]`` are valid.
        listed: ``(1,)`` how many they are.
        shown: Per pixel, 1 while it is known to be unsettled at the interval's end: a byte that
            spares a second visit to the whole record.
        row_due_us: A lower bound of the pixels' ``due_us`` in each row.
    """

    waiting: NDArray[np.int32]
    listed: NDArray[np.int64]
    shown: NDArray[np.uint8]
    row_due_us: NDArray[np.float64]


class Sensor(NamedTuple):
    """One specimen of the sensor.

    Attributes:
        pixels: ``(height, width)`` of :data:`~spikingtac.sim.camera.pixels.PIXEL_DTYPE`.
        chip: ``(1,)`` of :data:`~spikingtac.sim.camera.pixels.CHIP_DTYPE`.
        agenda: Pixels that need attention.
    """

    pixels: NDArray[Any]
    chip: NDArray[Any]
    agenda: Agenda


def make_sensor(
    config: CameraConfig, pattern: NDArray[np.float32], rng: np.random.Generator
) -> Sensor:
    """Draw a sensor.

    Args:
        config: The sensor's description.
        pattern: ``(p, p)`` relative brightness of the ground, periodic.
        rng: Draws mismatch, leak spread and the key of the counted random numbers.
    """
    width, height = config.size
    pixels = np.zeros((height, width), PIXEL_DTYPE)
    pixels["index"] = np.arange(height * width).reshape(height, width)
    _draw_mismatch(pixels, config.pixel, rng)
    brightest = _light_up(pixels, config, pattern)
    chip = np.zeros(1, CHIP_DTYPE)
    chip["rate"] = rate_at_white(config.pixel) / (1.0 + config.pixel.dark)
    for name in ("dark", "refractory_us", "latency_us", "jitter_us", "leak_jitter"):
        chip[name] = getattr(config.pixel, name)
    chip["key"] = rng.integers(0, 1 << 63)
    fill_tables(chip, config.light, brightest)
    agenda = Agenda(
        waiting=np.empty(height * width, np.int32),
        listed=np.zeros(1, np.int64),
        shown=np.zeros(height * width, np.uint8),
        row_due_us=np.full(height, np.inf),
    )
    return Sensor(pixels=pixels, chip=chip, agenda=agenda)


def _draw_mismatch(pixels: NDArray[Any], pixel: PixelConfig, rng: np.random.Generator) -> None:
    spread = pixel.mismatch * rng.standard_normal((2, *pixels.shape))
    for name, nominal, part in (
        ("on", pixel.threshold_on, spread[0]),
        ("off", pixel.threshold_off, spread[1]),
    ):
        pixels[name] = np.maximum(nominal + part, _LOWEST_THRESHOLD * nominal)
    decades = pixel.leak_spread * rng.standard_normal(pixels.shape)
    # A log-normal's mean exceeds its median; the configured rate is the mean over the array.
    mean = np.exp((pixel.leak_spread * np.log(10)) ** 2 / 2)
    pixels["mean_leak"] = pixels["on"] * pixel.leak_hz * 1e-6 * 10**decades / mean


def _light_up(pixels: NDArray[Any], config: CameraConfig, pattern: NDArray[np.float32]) -> float:
    """Write the light on bare ground and under a marker; return the brightest that can occur."""
    light = config.light
    height, width = pixels.shape
    marker, ground = intensities(light)
    gain = vignette(light, config.size)
    rows, columns = np.arange(height) % len(pattern), np.arange(width) % len(pattern)
    bare = gain * ground * (1 + pattern[rows[:, None], columns])
    pixels["base"] = (bare + light.stray).clip(DARKEST, None)
    pixels["lift"] = gain * marker + light.stray - pixels["base"]
    top = np.maximum(pixels["base"], pixels["base"] + pixels["lift"]).max()
    return float(top) * (1 + light.flicker_depth)


def settle_sensor(
    sensor: Sensor,
    coverage: NDArray[np.float32],
    now_us: float,
    history: str,
    rng: np.random.Generator,
) -> None:
    """Set every pixel to rest under an image.

    Args:
        sensor: Its state is overwritten.
        coverage: ``(height, width)`` by markers.
        now_us: Present time.
        history: ``rested``, ``random`` or ``fresh``; see ``EventCamera.settle``.
        rng: Draws the references' gaps.
    """
    pixels, chip = sensor.pixels, sensor.chip[0]
    draw = rng.random(pixels.shape)
    pixels["intensity"] = pixels["base"] + pixels["lift"] * coverage
    place = np.arange(len(chip["log"])) / chip["log_per_unit"]
    pixels["target"] = np.interp(pixels["intensity"], place, chip["log"])
    pixels["level"] = pixels["target"]
    pixels["leak"] = pixels["mean_leak"]
    if history == "fresh":
        gap = np.zeros(pixels.shape)
    elif history == "random":
        gap = draw * (pixels["on"] + pixels["off"]) - pixels["off"]
    else:  # without leak nothing moves the references while the sensor rests
        gap = np.where(pixels["mean_leak"] > 0, draw * pixels["on"], 0.0)
    pixels["gap"] = gap * (1 - _ROUNDING)
    pixels["seen_us"] = now_us
    pixels["dead_us"] = pixels["stamp_us"] = -np.inf
    pixels["listed"] = 0
    with np.errstate(divide="ignore"):
        wait_us = (pixels["on"] - pixels["gap"]) / pixels["mean_leak"].astype(np.float64)
    pixels["due_us"] = now_us + wait_us
    sensor.agenda.listed[0] = 0
    sensor.agenda.row_due_us[:] = pixels["due_us"].min(axis=1)
