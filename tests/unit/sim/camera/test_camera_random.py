import numpy as np
from numba import njit

from spikingtac.sim.pixels import (
    uniform_kernel,
)

KEY = np.uint64(0x1234_5678_9ABC_DEF1)


@njit
def draw_uniform(key, count):
    out = np.empty(count)
    for k in range(count):
        out[k] = uniform_kernel(key, np.uint64(k))
    return out


def splitmix(key: int, counter: int) -> float:
    """Plain Python, where integers never overflow: the reference of Steele, Lea and Flood."""
    mask = (1 << 64) - 1
    z = (key + counter * 0x9E3779B97F4A7C15) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    z ^= z >> 31
    return ((z >> 11) + 0.5) / (1 << 53)


def test_equals_the_published_generator():
    drawn = draw_uniform(KEY, 100)
    assert drawn.tolist() == [splitmix(int(KEY), k) for k in range(100)]
