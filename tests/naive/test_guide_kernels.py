"""The guide's levels against a plain loop."""

import numpy as np
import pytest

from spikingtac.viewer.guide import SLOWEST_SWING_US, SWUNG_LEVEL, levels_kernel

PIXELS = 6


def plain(code: np.ndarray, t_us: np.ndarray, on: float, off: float) -> tuple[np.ndarray, ...]:
    level = np.zeros((2, PIXELS), np.float32)
    swung, left = np.zeros((2, PIXELS), bool), np.zeros((2, PIXELS), np.int64)
    for one, t in zip(code.tolist(), t_us.tolist(), strict=True):
        pixel, brighter = divmod(one, 2)
        step = np.float32(on if brighter else -off)
        for row, sign in ((0, 1), (1, -1)):
            before = level[row, pixel]
            after = np.clip(before + np.float32(sign) * step, np.float32(0), np.float32(1))
            if before == 0 and after > 0:
                left[row, pixel] = t
            level[row, pixel] = after
            swung[row, pixel] |= after >= SWUNG_LEVEL and t - left[row, pixel] <= SLOWEST_SWING_US
    return level, swung, left


@pytest.mark.parametrize("spread_us", [1_000, 500_000])
def test_levels_are_those_of_a_plain_loop(spread_us: int) -> None:
    rng = np.random.default_rng(spread_us)
    code = rng.integers(0, 2 * PIXELS, 400).astype(np.uint32)
    t_us = np.cumsum(rng.integers(0, spread_us, 400)).astype(np.int64)
    maps = (
        np.zeros((2, PIXELS), np.float32),
        np.zeros((2, PIXELS), bool),
        np.zeros((2, PIXELS), np.int64),
    )
    levels_kernel(code, t_us, np.array([0.3, 0.2], np.float32), maps)
    for found, expected in zip(maps, plain(code, t_us, 0.3, 0.2), strict=True):
        np.testing.assert_array_equal(found, expected)
