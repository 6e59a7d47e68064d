"""The kernels of the discs' areas against plain loops over all pixels."""

import numpy as np
import pytest

from spikingtac.touch.indentation.disc_areas import (
    PROFILE_STEP_PX,
    disc_areas_kernel,
    disc_neighbours,
    return_outlines_kernel,
)

CENTRES = np.array([[12.3, 9.8], [30.0, 20.0], [0.5, 31.2], [45.0, 10.0]])
DENSE = np.array([[12.3, 9.8], [22.4, 9.8], [17.0, 18.5], [12.3, 20.1]])


def maps(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.random((32, 40)).astype(np.float32), rng.random((32, 40)).astype(np.float32)


def plain_owners(centres, bounds):
    """The disc of each pixel: the one to whose ring it has the shortest tangent."""
    rows, columns = np.mgrid[:32, :40]
    square = (columns[..., None] - centres[:, 0]) ** 2 + (rows[..., None] - centres[:, 1]) ** 2
    return (square - bounds[:, 1] ** 2).argmin(axis=2)


def plain_areas(memory, level, centres, bounds):
    out, owner = [], plain_owners(centres, bounds)
    rows, columns = np.mgrid[: level.shape[0], : level.shape[1]]
    for marker, ((x, y), (core, rim, reach)) in enumerate(zip(centres, bounds, strict=True)):
        square, own = (columns - x) ** 2 + (rows - y) ** 2, owner == marker
        for one in (memory, level):
            one[own & (square > rim**2) & (square <= reach**2)] = 0.0
            one[own & (square < core**2)] = 1.0
        out.append(level[own & (square <= rim**2)].sum(dtype=np.float64))
    return np.array(out)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("centres", [CENTRES, DENSE, DENSE[:1]])
def test_areas_and_wiping_are_those_of_a_plain_loop(seed: int, centres: np.ndarray):
    memory, level = maps(seed)
    bounds = np.array([[3.0, 6.0, 8.5], [0.0, 5.0, 5.0], [4.0, 7.0, 9.0], [1.0, 2.0, 3.0]])
    bounds, found = bounds[: len(centres)], np.empty(len(centres))
    expected_memory, expected_level = memory.copy(), level.copy()
    expected = plain_areas(expected_memory, expected_level, centres, bounds)
    disc_areas_kernel((memory, level), centres, bounds, disc_neighbours(centres), found)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_array_equal(memory, expected_memory)
    np.testing.assert_array_equal(level, expected_level)
    assert centres is not CENTRES or found[3] == 0.0  # outside of the sensor


def test_neighbours_are_the_nearest_discs():
    axis = np.arange(5.0)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    near = disc_neighbours(grid)
    assert sorted(near[12].tolist()) == [6, 7, 8, 11, 13, 16, 17, 18]
    assert disc_neighbours(DENSE).shape == (4, 3)
    assert disc_neighbours(DENSE[:1]).shape == (1, 0)


@pytest.mark.parametrize("centres", [CENTRES, DENSE])
def test_the_return_of_outlines_is_that_of_a_plain_loop(centres: np.ndarray):
    memory, level = maps(2)
    rim = np.array([6.0, 5.0, 7.0, 3.0])
    profiles = np.linspace(1.0, 0.0, 40) ** np.arange(1, 5)[:, None]
    expected = [memory.copy(), level.copy()]
    rows, columns = np.mgrid[:32, :40]
    bounds = np.column_stack([rim - 4.0, rim, rim + 3.0])
    owner = plain_owners(centres, bounds)
    for marker, (x, y) in enumerate(centres):
        reach, profile = rim[marker], profiles[marker]
        away = np.hypot(columns - x, rows - y)
        wanted = np.interp(away, np.arange(40) * PROFILE_STEP_PX, profile)
        for one in expected:
            one += np.where((owner == marker) & (away <= reach), 0.3 * (wanted - one), 0.0).astype(
                np.float32
            )
    near = disc_neighbours(centres)
    return_outlines_kernel((memory, level), centres, bounds, near, profiles, 0.3)
    np.testing.assert_allclose(memory, expected[0], atol=1e-5)
    np.testing.assert_allclose(level, expected[1], atol=1e-5)
