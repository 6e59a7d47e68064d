"""The classical denoisers against scipy.ndimage and against plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from spikingtac.denoise.classical import Box7, Median3

SHAPES = [(1, 1), (1, 9), (9, 1), (2, 2), (3, 5), (7, 7), (40, 33)]


def maps(shape: tuple[int, int]) -> list[np.ndarray]:
    rng = np.random.default_rng(shape[0] * 100 + shape[1])
    return [
        rng.random(shape, np.float32),
        (rng.random(shape) < 0.4).astype(np.float32),
        np.zeros(shape, np.float32),
        np.ones(shape, np.float32),
    ]


def naive_median(state_map: np.ndarray) -> np.ndarray:
    padded = np.pad(state_map, 1, mode="edge")
    out = np.empty_like(state_map)
    for y, x in np.ndindex(state_map.shape):
        out[y, x] = sorted(padded[y : y + 3, x : x + 3].ravel())[4]
    return out


@pytest.mark.parametrize("shape", SHAPES)
def test_median_equals_its_twins(shape: tuple[int, int]) -> None:
    denoiser = Median3()
    for state_map in maps(shape):
        cleaned = denoiser.clean(state_map)
        np.testing.assert_array_equal(cleaned, naive_median(state_map))
        expected = ndimage.median_filter(state_map, 3, mode="nearest")
        np.testing.assert_array_equal(cleaned, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_box_equals_its_twin(shape: tuple[int, int]) -> None:
    denoiser = Box7()
    for state_map in maps(shape):
        expected = ndimage.uniform_filter(state_map.astype(float), 7, mode="nearest")
        np.testing.assert_allclose(denoiser.clean(state_map), expected, atol=1e-6)
