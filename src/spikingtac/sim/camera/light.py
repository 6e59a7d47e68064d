"""Static light of the sensor: edge profile, vignetting, ground pattern and lookup tables."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from spikingtac.sim.camera.config import LightConfig, PixelConfig
from spikingtac.sim.camera.pixel_records import DECAY_ENTRIES, EDGE_ENTRIES, LOG_ENTRIES

_EDGE_TAIL = 5e-4
"""Coverage below which the tail of an edge is cut; at contrast 12.5 it is 1/40 of a threshold."""
_DECAY_MAX = 16.0
"""Number of time constants after which an exponential is taken as zero (1e-7)."""
_PIXEL_BOX_VARIANCE_PX2 = 1.0 / 12.0
_TEXTURE_PERIOD_PX = 512
_PATTERN_LOW = -0.9
"""Lowest and, negated, highest value of a pattern, so that the light never becomes negative."""
_INSTANT_PER_US = 1e6
"""Inverse time constant that stands for a photoreceptor without low-pass."""
_HEADROOM = 1.05
DARKEST = 1e-4
"""Lowest intensity that a pixel can see; white is 1."""


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
