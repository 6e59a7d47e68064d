"""The kernels of the discs' areas against plain loops over all pixels."""

import numpy as np
import pytest

from spikingtac.touch.indentation.disc_areas import (
    PROFILE_STEP_PX,
    disc_areas_kernel,
    return_outlines_kernel,
)

CENTRES = np.array([[12.3, 9.8], [30.0, 20.0], [0.5, 31.2], [45.0, 10.0]])
CROWDED = np.array([[12.3, 9.8], [22.0, 14.0], [13.5, 20.2], [45.0, 10.0]])
"""The rims of the first three lie within what is wiped around each other."""


def maps(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.random((32, 40)).astype(np.float32), rng.random((32, 40)).astype(np.float32)


def plain_areas(memory, level, centres, bounds):
    out = []
    rows, columns = np.mgrid[: level.shape[0], : level.shape[1]]
    squares = [(columns - x) ** 2 + (rows - y) ** 2 for x, y in centres]
    rims = [square <= rim**2 for square, (_, rim, _) in zip(squares, bounds, strict=True)]
    for square, (core, rim, reach) in zip(squares, bounds, strict=True):
        for one in (memory, level):
            one[(square > rim**2) & (square <= reach**2) & ~np.any(rims, axis=0)] = 0.0
            one[square < core**2] = 1.0
        out.append(level[square <= rim**2].sum(dtype=np.float64))
    return np.array(out)


@pytest.mark.parametrize("centres", [CENTRES, CROWDED])
def test_areas_and_wiping_are_those_of_a_plain_loop(centres: np.ndarray):
    memory, level = maps(0)
    bounds = np.array([[3.0, 6.0, 8.5], [0.0, 5.0, 5.0], [4.0, 7.0, 9.0], [1.0, 2.0, 3.0]])
    expected_memory, expected_level, found = memory.copy(), level.copy(), np.empty(4)
    expected = plain_areas(expected_memory, expected_level, centres, bounds)
    disc_areas_kernel(memory, level, centres, bounds, found)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_array_equal(memory, expected_memory)
    np.testing.assert_array_equal(level, expected_level)
    assert found[3] == 0.0  # outside of the sensor


def test_the_return_of_outlines_is_that_of_a_plain_loop():
    memory, level = maps(2)
    rim = np.array([6.0, 5.0, 7.0, 3.0])
    profiles = np.linspace(1.0, 0.0, 40) ** np.arange(1, 5)[:, None]
    expected = [memory.copy(), level.copy()]
    rows, columns = np.mgrid[:32, :40]
    for (x, y), reach, profile in zip(CENTRES, rim, profiles, strict=True):
        away = np.hypot(columns - x, rows - y)
        wanted = np.interp(away, np.arange(40) * PROFILE_STEP_PX, profile)
        for one in expected:
            one += np.where(away <= reach, 0.3 * (wanted - one), 0.0).astype(np.float32)
    return_outlines_kernel((memory, level), CENTRES, rim, profiles, 0.3)
    np.testing.assert_allclose(memory, expected[0], atol=1e-5)
    np.testing.assert_allclose(level, expected[1], atol=1e-5)
