"""Blob detection against scipy.ndimage, on random, structured and edge maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from spikingtac.markers.blobs import find_blobs

EVERYTHING = 0.0, 1e9  # Areas, px.


def twin(state_map: np.ndarray, threshold: float) -> tuple[np.ndarray, ...]:
    bright = state_map >= np.float32(threshold)
    labels, count = ndimage.label(bright, structure=np.ones((3, 3)))
    index = np.arange(1, count + 1)
    if count == 0:
        return np.empty((0, 2)), np.empty(0), np.empty(0, bool)
    centers = np.array(ndimage.center_of_mass(state_map.astype(float), labels, index))[:, ::-1]
    border = np.zeros_like(bright)
    border[[0, -1], :] = border[:, [0, -1]] = True
    return (
        centers,
        ndimage.sum_labels(bright, labels, index),
        ndimage.maximum(border, labels, index) > 0,
    )


def assert_equal_to_twin(state_map: np.ndarray, threshold: float) -> None:
    found = find_blobs(state_map, threshold, EVERYTHING)
    centers, area, cut = twin(state_map, threshold)
    np.testing.assert_allclose(found.center_px, centers, atol=1e-9)
    np.testing.assert_array_equal(found.area_px, area)
    np.testing.assert_array_equal(found.cut, cut)


@pytest.mark.parametrize("density", [0.0, 0.02, 0.2, 0.4, 0.6, 0.95, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (33, 47), (50, 16), (20, 65)])
def test_binary_maps_equal_the_twin(density: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(int(100 * density) + shape[0])
    for _ in range(5):
        assert_equal_to_twin((rng.random(shape) < density).astype(np.float32), 0.5)


@pytest.mark.parametrize("threshold", [0.2, 0.5, 1.0])
def test_graded_maps_equal_the_twin(threshold: float) -> None:
    rng = np.random.default_rng(7)
    assert_equal_to_twin(rng.random((60, 71), np.float32), threshold)


def test_spirals_and_combs_join() -> None:
    comb = np.zeros((12, 31), np.float32)
    comb[:, ::2] = 1.0
    comb[-1, :] = 1.0
    assert_equal_to_twin(comb, 0.5)
    assert_equal_to_twin(comb[::-1].copy(), 0.5)
    checkers = (np.indices((9, 9)).sum(axis=0) % 2).astype(np.float32)
    assert_equal_to_twin(checkers, 0.5)
    assert len(find_blobs(checkers, areas_px=EVERYTHING)) == 1, "corners connect"


def test_area_limits_and_cut_markers() -> None:
    state_map = np.zeros((30, 40), np.float32)
    state_map[2, 2] = 1.0  # noise
    state_map[0:5, 10:16] = 1.0  # cut by the border
    state_map[10:25, 10:30] = 1.0  # too large
    state_map[8:13, 33:38] = 1.0
    blobs = find_blobs(state_map, areas_px=(20.0, 100.0))
    assert blobs.area_px.tolist() == [30.0, 25.0]
    assert blobs.cut.tolist() == [True, False]
    assert blobs.center_px[1].tolist() == [35.0, 10.0]
