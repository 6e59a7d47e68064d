"""Rendering of the whole frame for light that changes at every pixel.

Flicker, a moving pattern, the high-pass filter and photoreceptor noise leave no pixel at rest, so
that every pixel is updated at every step. This takes some hundred times as long as a still scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.light import (
    DARKEST,
    intensities,
    inverse_time_constant_at_white,
    vignette,
)
from spikingtac.sim.camera.pixel_coverage import coverage_image_kernel
from spikingtac.sim.camera.pixel_records import (
    exponential_decay_kernel,
    inverse_time_constant_kernel,
)
from spikingtac.sim.camera.pixels import (
    advance_light_ramp_kernel,
    change_below_threshold_kernel,
    emit_crossings_kernel,
)
from spikingtac.sim.camera.random import normal_pair_kernel, pixel_counter_kernel
from spikingtac.sim.camera.sensor import Sensor
from spikingtac.sim.camera.sweep import MarkerSweep, interpolate_disc_kernel

_FLICKER_STEPS = 20
"""Steps per period of a flickering light."""

AUXILIARY_DTYPE = np.dtype([("high_passed", "f4"), ("noise", "f4")])
"""State of a pixel that only these options need."""


class FrameParameters(NamedTuple):
    """Light and filters that stay constant between the steps.

    Attributes:
        gain: ``(height, width)`` vignetting.
        pattern: ``(p, p)`` periodic relative brightness of the ground.
        marker: Intensity of a marker.
        ground: Intensity of the ground.
        stray: Stray light.
        noise: Standard deviation of the photoreceptor noise, in log intensity.
        key: Key of its random numbers.
    """

    gain: NDArray[np.float32]
    pattern: NDArray[np.float32]
    marker: float
    ground: float
    stray: float
    noise: float
    key: np.uint64


class FrameStep(NamedTuple):
    """Values that change from step to step.

    Attributes:
        lamp: Relative brightness of the lamp.
        shift_x: Shift of the pattern along x, px.
        shift_y: Shift of the pattern along y, px.
        high_pass_decay: Factor by which the high-pass filter decays in the step.
        number: Number of the step since the start.
        end_us: End of the step, us.
        span_us: Length of the step, us.
    """

    lamp: float
    shift_x: float
    shift_y: float
    high_pass_decay: float
    number: int
    end_us: float
    span_us: float


def needs_full_frame(config: CameraConfig) -> bool:
    """Return True if every pixel must be updated at every step."""
    light, pixel = config.light, config.pixel
    moving = light.texture > 0 and light.texture_follow != 0
    return moving or light.flicker_depth > 0 or pixel.high_pass_hz > 0 or pixel.noise > 0


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
def _noise_change_kernel(
    px: Any, chip: Any, aux: Any, parameters: FrameParameters, step: FrameStep
) -> float:
    """Draw the next noise of a pixel, filtered like the photoreceptor; return its change."""
    rate_per_us = inverse_time_constant_kernel(chip, px["intensity"])
    decay = exponential_decay_kernel(chip, step.span_us * rate_per_us)
    draw, _ = normal_pair_kernel(parameters.key, pixel_counter_kernel(px["index"], step.number))
    last = float(aux["noise"])
    rise = last * (decay - 1.0) + parameters.noise * math.sqrt(1.0 - decay * decay) * draw
    aux["noise"] = last + rise
    return rise


@njit(cache=True, nogil=True, error_model="numpy")
def full_frame_kernel(
    sensor: Sensor,
    auxiliary: NDArray[Any],
    coverage: NDArray[np.float32],
    parameters: FrameParameters,
    step: FrameStep,
    out: NDArray[np.int64],
) -> None:
    """Advance every pixel by one step.

    Args:
        sensor: State of the pixels, advanced.
        auxiliary: ``(height, width)`` of :data:`AUXILIARY_DTYPE`, advanced.
        coverage: ``(height, width)`` fractions that the markers cover at the end of the step.
        parameters: Constant light and filters.
        step: Values of this step.
        out: ``out[0]`` counts the events, whose keys follow.
    """
    pixels, chip = sensor.pixels, sensor.chip[0]
    start_us = step.end_us - step.span_us
    for y in range(pixels.shape[0]):
        for x in range(pixels.shape[1]):
            px, aux = pixels[y, x], auxiliary[y, x]
            relative = sample_pattern_kernel(parameters.pattern, x - step.shift_x, y - step.shift_y)
            ground = parameters.ground * (1.0 + relative)
            light = ground + (parameters.marker - ground) * coverage[y, x]
            intensity = max(parameters.gain[y, x] * light + parameters.stray, DARKEST) * step.lamp
            level = float(px["level"])
            rise = advance_light_ramp_kernel(px, chip, intensity, step.end_us, step.span_us)
            if step.high_pass_decay < 1.0:
                change = px["level"] - level
                high_passed = aux["high_passed"] * step.high_pass_decay + change
                rise += high_passed - aux["high_passed"] - change
                aux["high_passed"] = high_passed
            if parameters.noise > 0.0:
                rise += _noise_change_kernel(px, chip, aux, parameters, step)
            if not change_below_threshold_kernel(px, start_us, rise):
                emit_crossings_kernel(px, chip, out, start_us, step.span_us, rise)


class FullFrameRenderer:
    """Renders every pixel at every step.

    Args:
        config: Settings of the camera.
        pattern: ``(p, p)`` relative brightness of the ground.
        rng: Source of the key of the noise.
    """

    def __init__(
        self, config: CameraConfig, pattern: NDArray[np.float32], rng: np.random.Generator
    ) -> None:
        marker, ground = intensities(config.light)
        width, height = config.size
        self._config = config
        self._coverage = np.empty((height, width), np.float32)
        self._auxiliary = np.zeros((height, width), AUXILIARY_DTYPE)
        self._parameters = FrameParameters(
            gain=vignette(config.light, config.size).astype(np.float32),
            pattern=pattern,
            marker=marker,
            ground=ground,
            stray=config.light.stray,
            noise=config.pixel.noise,
            key=np.uint64(rng.integers(0, 1 << 63)),
        )

    def settle(self, discs: NDArray[Any], now_us: float) -> None:
        """Start from resting markers. The phase of the lamp is 0 and the pattern is not shifted."""
        self._auxiliary[:] = 0
        self._origin = _mean_place(discs)
        self._start_us = now_us
        self._number = 0

    def render(
        self, sensor: Sensor, sweep: MarkerSweep, out: NDArray[np.int64], drain: Callable[[], None]
    ) -> None:
        """Render the motion between two images. ``drain`` empties ``out`` after each step."""
        steps = self._steps(sweep)
        span_us = (sweep.end_us - sweep.start_us) / steps
        for number in range(1, steps + 1):
            for before, after, now in zip(sweep.before, sweep.after, sweep.now, strict=True):
                interpolate_disc_kernel(before, after, number / steps, now)
            coverage_image_kernel(sweep.now, sweep.plan, sensor.chip[0], self._coverage)
            end_us = sweep.end_us if number == steps else sweep.start_us + number * span_us
            step = self._step(sweep.now, end_us, span_us)
            full_frame_kernel(sensor, self._auxiliary, self._coverage, self._parameters, step, out)
            drain()
        sweep.before[:] = sweep.after

    def _steps(self, sweep: MarkerSweep) -> int:
        light, pixel = self._config.light, self._config.pixel
        longest_us = self._config.steps.max_us
        if light.flicker_depth > 0:
            longest_us = min(longest_us, 1e6 / (light.flicker_hz * _FLICKER_STEPS))
        if pixel.noise > 0:
            longest_us = min(longest_us, max(1.0 / inverse_time_constant_at_white(pixel), 1.0))
        fewest = math.ceil((sweep.end_us - sweep.start_us) / longest_us)
        return max(1, fewest, int(sweep.plan["steps"].max(initial=1)))

    def _step(self, discs: NDArray[Any], end_us: float, span_us: float) -> FrameStep:
        light = self._config.light
        shift = light.texture_follow * (_mean_place(discs) - self._origin)
        phase = 2 * math.pi * light.flicker_hz * (end_us - self._start_us) * 1e-6
        self._number += 1
        return FrameStep(
            lamp=1.0 + light.flicker_depth * math.sin(phase),
            shift_x=float(shift[0]),
            shift_y=float(shift[1]),
            high_pass_decay=math.exp(
                -2 * math.pi * self._config.pixel.high_pass_hz * span_us * 1e-6
            ),
            number=self._number,
            end_us=end_us,
            span_us=span_us,
        )


def _mean_place(discs: NDArray[Any]) -> NDArray[np.float64]:
    if not len(discs):
        return np.zeros(2)
    return np.array([discs["x"].mean(), discs["y"].mean()])
