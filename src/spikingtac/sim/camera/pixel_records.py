"""Records of pixels and sensor, their lookup tables, and random numbers for kernels.

Counter-based random numbers for kernels. The order of the computation does not change them.

A number is a hash of (key, counter) by the SplitMix64 finaliser (Steele, Lea, Flood 2014,
doi:10.1145/2660193.2660195). Every operand is an unsigned 64-bit integer, because Numba converts a
mix of signed and unsigned integers to float, which ruins such a generator without an error.

Records of pixels and sensor, and the lookup tables that the kernels read.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
_DROP_TO_53_BITS = np.uint64(11)
_UNIT_53 = 1.0 / (1 << 53)
_PIXEL_SHIFT = np.uint64(32)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def uniform_kernel(key: np.uint64, counter: np.uint64) -> float:
    """Return a number uniform in (0, 1) for a uint64 key and a uint64 counter."""
    bits = key + counter * _GOLDEN
    bits = (bits ^ (bits >> _SHIFTS[0])) * _MIX_1
    bits = (bits ^ (bits >> _SHIFTS[1])) * _MIX_2
    bits = bits ^ (bits >> _SHIFTS[2])
    return (np.float64(bits >> _DROP_TO_53_BITS) + 0.5) * _UNIT_53


@njit(cache=True, nogil=True, error_model="numpy")
def normal_pair_kernel(key: np.uint64, counter: np.uint64) -> tuple[float, float]:
    """Return two independent standard normal numbers (Box-Muller transform).

    The call uses the uniform numbers at the counters ``2 * counter`` and ``2 * counter + 1``.
    """
    first = counter * np.uint64(2)
    radius = math.sqrt(-2.0 * math.log(uniform_kernel(key, first)))
    angle = 2.0 * math.pi * uniform_kernel(key, first + np.uint64(1))
    return radius * math.cos(angle), radius * math.sin(angle)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def pixel_counter_kernel(pixel: int, count: int) -> np.uint64:
    """Return the counter of a pixel's draw number ``count`` (both below 2**31)."""
    return (np.uint64(pixel) << _PIXEL_SHIFT) + np.uint64(count)


# Number of bits below the time in an event's key: ``(t_us << 24) | (pixel << 1) | on``.
KEY_SHIFT = 24

# Intensities (white is 1) that differ by less are equal; the log table is no finer.
_SAME_LIGHT = 1e-6

# Parameters and state of one pixel, in one record: an update touches one place in memory.
PIXEL_DTYPE = np.dtype(
    [
        ("updated_us", "f8"),  # time up to which the state is valid
        ("dead_until_us", "f8"),  # end of the dead time, us
        ("leak_due_us", "f8"),  # time of the next leak event; "never" while unsettled
        ("last_event_us", "f8"),  # time stamp of the last event
        ("intensity", "f4"),  # present light, white is 1
        ("previous_intensity", "f4"),  # light at the start of the present span
        ("target_level", "f4"),  # log of the present light
        ("level", "f4"),  # low-passed log light
        ("difference", "f4"),  # level minus reference; undefined in the dead time
        ("leak_per_us", "f4"),  # present drift of the difference, 1/us
        ("threshold_on", "f4"),  # log intensity
        ("threshold_off", "f4"),  # log intensity
        ("mean_leak_per_us", "f4"),  # mean of ``leak_per_us``
        ("ground_intensity", "f4"),  # intensity without a marker
        ("marker_increment", "f4"),  # intensity that full coverage adds
        ("event_count", "u4"),  # number of events so far
        ("index", "i4"),  # row-major index
        ("queued", "u1"),  # 1 while in the list of unsettled pixels
    ],
    align=True,
)
EDGE_ENTRIES = 512
LOG_ENTRIES = 2048
DECAY_ENTRIES = 1024

# Parameters that all pixels share, in one record: Numba counts references to arrays only.
CHIP_DTYPE = np.dtype(
    [
        ("white_rate_per_us", "f8"),  # inverse time constant per unit of (intensity + dark), 1/us
        ("dark", "f8"),  # dark current as an intensity
        ("refractory_us", "f8"),
        ("latency_us", "f8"),  # at intensity 1
        ("jitter_us", "f8"),
        ("leak_jitter", "f8"),  # relative, drawn after each event
        ("key", "u8"),  # of the random numbers
        ("edge_half_width_px", "f8"),  # half-width of an edge: beyond it coverage is exactly 0 or 1
        ("edge_per_px", "f8"),  # entries of ``edge`` per px
        ("log_per_unit", "f8"),  # entries of ``log`` per unit of intensity
        ("decay_per_unit", "f8"),  # entries of ``decay`` per time constant
        ("edge_coverage", "f4", (EDGE_ENTRIES,)),  # coverage from outside to inside of an edge
        ("log_intensity", "f4", (LOG_ENTRIES,)),  # logarithm by intensity
        ("decay_table", "f4", (DECAY_ENTRIES,)),  # exp(-x), the last one 0
    ],
    align=True,
)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inverse_time_constant_kernel(chip: Any, intensity: float) -> float:
    """Return the photoreceptor's inverse time constant at an intensity, 1/us."""
    return chip["white_rate_per_us"] * (intensity + chip["dark"])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def log_intensity_kernel(chip: Any, intensity: float) -> float:
    """Return the logarithm of an intensity from the table."""
    place = intensity * chip["log_per_unit"]
    low = min(int(place), LOG_ENTRIES - 2)
    first = chip["log_intensity"][low]
    return first + (place - low) * (chip["log_intensity"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def exponential_decay_kernel(chip: Any, time_constants: float) -> float:
    """Return exp(-x) from the table for ``x`` time constants."""
    place = time_constants * chip["decay_per_unit"]
    if place >= DECAY_ENTRIES - 1:
        return 0.0
    low = int(place)
    first = chip["decay_table"][low]
    return first + (place - low) * (chip["decay_table"][low + 1] - first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def intensity_kernel(px: Any, covered: float) -> float:
    """Return the intensity at a pixel of which the markers cover a fraction (0 to 1)."""
    return px["ground_intensity"] + px["marker_increment"] * covered


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def same_light_kernel(px: Any, intensity: float) -> bool:
    """Return True if an intensity equals the one that the pixel saw last."""
    return abs(intensity - px["intensity"]) < _SAME_LIGHT
