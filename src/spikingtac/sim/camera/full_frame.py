"""Rendering of the whole frame for a pattern that moves behind the markers.

Such a pattern leaves no pixel at rest, so that every pixel is updated at every step. This takes
some hundred times as long as a still scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.coverage import coverage_image_kernel
from spikingtac.sim.camera.pixels import (
    advance_light_ramp_kernel,
    change_below_threshold_kernel,
    emit_crossings_kernel,
)
from spikingtac.sim.camera.sensor import DARKEST, Sensor, intensities, vignette
from spikingtac.sim.camera.sweep import MarkerSweep, interpolate_disc_kernel


class Ground(NamedTuple):
    """The light of the ground and of the markers on it.

    Attributes:
        gain: ``(height, width)`` vignetting.
        pattern: ``(p, p)`` periodic relative brightness of the ground.
        marker: Intensity of a marker.
        ground: Mean intensity of the ground.
        stray: Stray light.
    """

    gain: NDArray[np.float32]
    pattern: NDArray[np.float32]
    marker: float
    ground: float
    stray: float


@njit(cache=True, nogil=True, error_model="numpy")
def sample_pattern_kernel(pattern: NDArray[np.float32], x: float, y: float) -> float:
    """Return the value of a periodic pattern between its samples (bilinear interpolation)."""
    rows, columns = pattern.shape
    left, top = math.floor(x), math.floor(y)
    fraction_x, fraction_y = x - left, y - top
    x0, y0 = left % columns, top % rows
    x1, y1 = (x0 + 1) % columns, (y0 + 1) % rows
    upper = pattern[y0, x0] + fraction_x * (pattern[y0, x1] - pattern[y0, x0])
    lower = pattern[y1, x0] + fraction_x * (pattern[y1, x1] - pattern[y1, x0])
    return float(upper + fraction_y * (lower - upper))


@njit(cache=True, nogil=True, error_model="numpy")
def full_frame_kernel(
    sensor: Sensor,
    coverage: NDArray[np.float32],
    ground: Ground,
    shift_px: tuple[float, float],
    times: tuple[float, float],
    out: NDArray[np.int64],
) -> None:
    """Advance every pixel by one step.

    Args:
        sensor: State of the pixels, advanced.
        coverage: ``(height, width)`` fractions that the markers cover at the end of the step.
        ground: Light of ground and markers.
        shift_px: Shift of the pattern at the end of the step along x and y, px.
        times: End and length of the step, us.
        out: ``out[0]`` counts the events, whose keys follow.
    """
    pixels, chip = sensor.pixels, sensor.chip[0]
    end_us, span_us = times
    start_us = end_us - span_us
    for y in range(pixels.shape[0]):
        for x in range(pixels.shape[1]):
            px = pixels[y, x]
            relative = sample_pattern_kernel(ground.pattern, x - shift_px[0], y - shift_px[1])
            bare = ground.ground * (1.0 + relative)
            light = bare + (ground.marker - bare) * coverage[y, x]
            intensity = max(ground.gain[y, x] * light + ground.stray, DARKEST)
            rise = advance_light_ramp_kernel(px, chip, intensity, end_us, span_us)
            if not change_below_threshold_kernel(px, start_us, rise):
                emit_crossings_kernel(px, chip, out, start_us, span_us, rise)


class FullFrameRenderer:
    """Renders every pixel at every step.

    Args:
        config: Settings of the camera.
        pattern: ``(p, p)`` relative brightness of the ground.
    """

    def __init__(self, config: CameraConfig, pattern: NDArray[np.float32]) -> None:
        width, height = config.size
        self._config = config
        self._coverage = np.empty((height, width), np.float32)
        gain = vignette(config.light, config.size).astype(np.float32)
        self._ground = Ground(gain, pattern, *intensities(config.light), config.light.stray)

    def settle(self, discs: NDArray[Any]) -> None:
        """Start from resting markers, where the pattern is not shifted."""
        self._origin = _mean_place(discs)

    def render(
        self, sensor: Sensor, sweep: MarkerSweep, out: NDArray[np.int64], drain: Callable[[], None]
    ) -> None:
        """Render the motion between two images. ``drain`` empties ``out`` after each step."""
        fewest = math.ceil((sweep.end_us - sweep.start_us) / self._config.steps.max_us)
        steps = max(1, fewest, int(sweep.plan["steps"].max(initial=1)))
        span_us = (sweep.end_us - sweep.start_us) / steps
        for number in range(1, steps + 1):
            for before, after, now in zip(sweep.before, sweep.after, sweep.now, strict=True):
                interpolate_disc_kernel(before, after, number / steps, now)
            coverage_image_kernel(sweep.now, sweep.plan, sensor.chip[0], self._coverage)
            end_us = sweep.end_us if number == steps else sweep.start_us + number * span_us
            moved = self._config.light.texture_follow * (_mean_place(sweep.now) - self._origin)
            shift_px = float(moved[0]), float(moved[1])
            times = end_us, span_us
            full_frame_kernel(sensor, self._coverage, self._ground, shift_px, times, out)
            drain()
        sweep.before[:] = sweep.after


def _mean_place(discs: NDArray[Any]) -> NDArray[np.float64]:
    if not len(discs):
        return np.zeros(2)
    return np.array([discs["x"].mean(), discs["y"].mean()])
