"""Light that changes everywhere: flicker, a moving pattern, high-pass, photoreceptor noise.

These options have no resting pixels, so that every pixel is computed at every step: some hundred
times the work of a still scene without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.light import DARKEST, intensities, rate_at_white, vignette
from spikingtac.sim.camera.pixel_coverage import paint_kernel
from spikingtac.sim.camera.pixels import (
    cross_kernel,
    decay_kernel,
    quiet_kernel,
    rate_kernel,
    relight_kernel,
)
from spikingtac.sim.camera.random import normal_pair_kernel, pixel_counter_kernel
from spikingtac.sim.camera.sensor import Sensor
from spikingtac.sim.camera.sweep import Motion, place_kernel

_FLICKER_STEPS = 20
"""Steps in a period of a flickering light."""

AUXILIARY_DTYPE = np.dtype([("high_passed", "f4"), ("noise", "f4")])
"""What a pixel remembers for these options alone."""


class Scenery(NamedTuple):
    """Light and filters of one step.

    Attributes:
        gain: ``(height, width)`` vignetting.
        pattern: ``(p, p)`` periodic relative brightness of the ground.
        marker: Light of a marker.
        ground: Light of the ground.
        stray: Veiling light.
        noise: Standard deviation of the photoreceptor's noise.
        key: Of its random numbers.
    """

    gain: NDArray[np.float32]
    pattern: NDArray[np.float32]
    marker: float
    ground: float
    stray: float
    noise: float
    key: np.uint64


class Step(NamedTuple):
    """What changes from step to step: lamp, pattern's shift in px, high-pass decay, time."""

    lamp: float
    shift_x: float
    shift_y: float
    keep: float
    number: int
    end_us: float
    span_us: float


def is_dense(config: CameraConfig) -> bool:
    """Return True if a camera needs every pixel at every step."""
    light, pixel = config.light, config.pixel
    moving = light.texture > 0 and light.texture_follow != 0
    return moving or light.flicker_depth > 0 or pixel.high_pass_hz > 0 or pixel.noise > 0


@njit(cache=True, nogil=True, error_model="numpy")
def pattern_kernel(pattern: NDArray[np.float32], x: float, y: float) -> float:
    """Return a periodic pattern's value between its samples (bilinear)."""
    rows, columns = pattern.shape
    left, top = math.floor(x), math.floor(y)
    part_x, part_y = x - left, y - top
    x0, y0 = left % columns, top % rows
    x1, y1 = (x0 + 1) % columns, (y0 + 1) % rows
    upper = pattern[y0, x0] + part_x * (pattern[y0, x1] - pattern[y0, x0])
    lower = pattern[y1, x0] + part_x * (pattern[y1, x1] - pattern[y1, x0])
    return float(upper + part_y * (lower - upper))


@njit(cache=True, nogil=True, error_model="numpy")
def _noise_rise_kernel(px: Any, chip: Any, aux: Any, scenery: Scenery, step: Step) -> float:
    """Draw a pixel's next noise, which has the photoreceptor's pole; return its rise."""
    keep = decay_kernel(chip, step.span_us * rate_kernel(chip, px["intensity"]))
    draw, _ = normal_pair_kernel(scenery.key, pixel_counter_kernel(px["index"], step.number))
    last = float(aux["noise"])
    rise = last * (keep - 1.0) + scenery.noise * math.sqrt(1.0 - keep * keep) * draw
    aux["noise"] = last + rise
    return rise


@njit(cache=True, nogil=True, error_model="numpy")
def dense_kernel(
    sensor: Sensor,
    auxiliary: NDArray[Any],
    coverage: NDArray[np.float32],
    scenery: Scenery,
    step: Step,
    out: NDArray[np.int64],
) -> None:
    """Carry every pixel through one step; the keys of all events follow ``out[0]``."""
    pixels, chip = sensor.pixels, sensor.chip[0]
    start_us = step.end_us - step.span_us
    for y in range(pixels.shape[0]):
        for x in range(pixels.shape[1]):
            px, aux = pixels[y, x], auxiliary[y, x]
            relative = pattern_kernel(scenery.pattern, x - step.shift_x, y - step.shift_y)
            bare = scenery.ground * (1.0 + relative)
            seen = bare + (scenery.marker - bare) * coverage[y, x]
            intensity = max(scenery.gain[y, x] * seen + scenery.stray, DARKEST) * step.lamp
            level = float(px["level"])
            rise = relight_kernel(px, chip, intensity, step.end_us, step.span_us)
            if step.keep < 1.0:
                moved = px["level"] - level
                passed = aux["high_passed"] * step.keep + moved
                rise += passed - aux["high_passed"] - moved
                aux["high_passed"] = passed
            if scenery.noise > 0.0:
                rise += _noise_rise_kernel(px, chip, aux, scenery, step)
            if not quiet_kernel(px, start_us, rise):
                cross_kernel(px, chip, out, start_us, step.span_us, rise)


class DenseRenderer:
    """Renders every pixel at every step.

    Args:
        config: The camera.
        pattern: ``(p, p)`` relative brightness of the ground.
        rng: Draws the key of the noise.
    """

    def __init__(
        self, config: CameraConfig, pattern: NDArray[np.float32], rng: np.random.Generator
    ) -> None:
        marker, ground = intensities(config.light)
        width, height = config.size
        self._config = config
        self._coverage = np.empty((height, width), np.float32)
        self._auxiliary = np.zeros((height, width), AUXILIARY_DTYPE)
        self._scenery = Scenery(
            gain=vignette(config.light, config.size).astype(np.float32),
            pattern=pattern,
            marker=marker,
            ground=ground,
            stray=config.light.stray,
            noise=config.pixel.noise,
            key=np.uint64(rng.integers(0, 1 << 63)),
        )

    def settle(self, discs: NDArray[Any], now_us: float) -> None:
        """Start from resting markers; the lamp's phase is 0 and the pattern unmoved."""
        self._auxiliary[:] = 0
        self._origin = _mean_place(discs)
        self._start_us = now_us
        self._number = 0

    def render(
        self, sensor: Sensor, motion: Motion, out: NDArray[np.int64], drain: Callable[[], None]
    ) -> None:
        """Render the motion between two images, calling ``drain`` after each step."""
        steps = self._steps(motion)
        span_us = (motion.end_us - motion.start_us) / steps
        for number in range(1, steps + 1):
            for before, after, now in zip(motion.before, motion.after, motion.now, strict=True):
                place_kernel(before, after, number / steps, now)
            paint_kernel(motion.now, motion.work, sensor.chip[0], self._coverage)
            end_us = motion.end_us if number == steps else motion.start_us + number * span_us
            step = self._step(motion.now, end_us, span_us)
            dense_kernel(sensor, self._auxiliary, self._coverage, self._scenery, step, out)
            drain()
        motion.before[:] = motion.after

    def _steps(self, motion: Motion) -> int:
        light, pixel = self._config.light, self._config.pixel
        longest_us = self._config.steps.max_us
        if light.flicker_depth > 0:
            longest_us = min(longest_us, 1e6 / (light.flicker_hz * _FLICKER_STEPS))
        if pixel.noise > 0:
            longest_us = min(longest_us, max(1.0 / rate_at_white(pixel), 1.0))
        fewest = math.ceil((motion.end_us - motion.start_us) / longest_us)
        return max(1, fewest, int(motion.work["steps"].max(initial=1)))

    def _step(self, discs: NDArray[Any], end_us: float, span_us: float) -> Step:
        light = self._config.light
        shift = light.texture_follow * (_mean_place(discs) - self._origin)
        phase = 2 * math.pi * light.flicker_hz * (end_us - self._start_us) * 1e-6
        self._number += 1
        return Step(
            lamp=1.0 + light.flicker_depth * math.sin(phase),
            shift_x=float(shift[0]),
            shift_y=float(shift[1]),
            keep=math.exp(-2 * math.pi * self._config.pixel.high_pass_hz * span_us * 1e-6),
            number=self._number,
            end_us=end_us,
            span_us=span_us,
        )


def _mean_place(discs: NDArray[Any]) -> NDArray[np.float64]:
    if not len(discs):
        return np.zeros(2)
    return np.array([discs["x"].mean(), discs["y"].mean()])
