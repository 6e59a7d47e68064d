"""The deviation of markers from their neighbourhoods against medians of whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.lost_markers import deviation_kernel

Array = np.ndarray


def deviation(displacement: Array, near: Array, factor: float, least: float) -> Array:
    around = displacement[near]
    middle = len(near) // 2
    median = np.sort(around, axis=0)[middle]
    spread = np.sort(np.abs(around - median), axis=0)[middle]
    return (np.abs(displacement - median) / (factor * spread + least)).max(axis=1)


@pytest.mark.parametrize("neighbours", [1, 4, 9])
@pytest.mark.parametrize("seed", range(4))
def test_deviations_are_those_of_whole_arrays(neighbours: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    moved = rng.normal(size=(40, 2)) * (seed > 0)
    moved[5] += 30.0
    near = rng.integers(0, 40, (neighbours, 40))
    off = np.empty(40)
    deviation_kernel(moved, near, 4.0, 1.1, off)
    np.testing.assert_array_equal(off, deviation(moved, near, 4.0, 1.1))
