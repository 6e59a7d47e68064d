"""Counter-based random numbers for kernels. The order of the computation does not change them.

A number is a hash of (key, counter) by the SplitMix64 finaliser (Steele, Lea, Flood 2014,
doi:10.1145/2660193.2660195). Every operand is an unsigned 64-bit integer, because Numba converts a
mix of signed and unsigned integers to float, which ruins such a generator without an error.
"""

from __future__ import annotations

import math

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
