"""The published front end's parts against scipy.ndimage and plain Python."""

import numpy as np
import pytest
from scipy import ndimage

from spikingtac.denoise.classical import Box7
from spikingtac.markers.blobs import UNMATCHED, associate, find_blobs

EVERYTHING = 0.0, 1e9  # Areas, px.


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (7, 7), (40, 33)])
def test_the_box_equals_its_twin(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[0] * 100 + shape[1])
    binary = (rng.random(shape) < 0.4).astype(np.float32)
    for state_map in (rng.random(shape, np.float32), binary, np.ones(shape, np.float32)):
        mean = ndimage.uniform_filter(state_map.astype(float), 7, mode="nearest")
        np.testing.assert_allclose(Box7().clean(state_map), mean, atol=1e-6)


def assert_equal_to_twin(state_map: np.ndarray, threshold: float) -> None:
    found = find_blobs(state_map, threshold, EVERYTHING)
    bright, level = state_map >= np.float32(threshold), state_map.astype(float)
    labels, count = ndimage.label(bright, structure=np.ones((3, 3)))
    index = np.arange(1, count + 1)
    border = np.zeros_like(bright)
    border[[0, -1], :] = border[:, [0, -1]] = True
    centers = np.array(ndimage.center_of_mass(level, labels, index)).reshape(-1, 2)[:, ::-1]
    np.testing.assert_allclose(found.center_px, centers, atol=1e-9)
    np.testing.assert_array_equal(found.area_px, ndimage.sum_labels(bright, labels, index))
    np.testing.assert_array_equal(found.cut, ndimage.sum_labels(border, labels, index) > 0)


@pytest.mark.parametrize("density", [0.0, 0.2, 0.4, 0.6, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (33, 47), (20, 65)])
def test_blobs_equal_the_twin(density: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(int(100 * density) + shape[0])
    for _ in range(5):
        assert_equal_to_twin((rng.random(shape) < density).astype(np.float32), 0.5)
        assert_equal_to_twin(rng.random(shape, np.float32), density)


def test_spirals_and_combs_join() -> None:
    comb = np.zeros((12, 31), np.float32)
    comb[:, ::2] = 1.0
    comb[-1, :] = 1.0
    checkers = (np.indices((9, 9)).sum(axis=0) % 2).astype(np.float32)
    for state_map in (comb, comb[::-1].copy(), checkers):
        assert_equal_to_twin(state_map, 0.5)
        assert len(find_blobs(state_map, areas_px=EVERYTHING).area_px) == 1


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


@pytest.mark.parametrize("markers", [0, 1, 64])
@pytest.mark.parametrize("centroids", [0, 1, 50, 300])
@pytest.mark.parametrize("proximity_px", [0.0, 8.0, 60.0, np.inf])
def test_the_tree_and_plain_python_associate_alike(
    markers: int, centroids: int, proximity_px: float
) -> None:
    rng = np.random.default_rng(markers + centroids)
    previous, detected = (rng.uniform(0, 320, (count, 2)) for count in (markers, centroids))
    expected = np.full(markers, UNMATCHED)
    if markers and centroids:
        away_px = np.linalg.norm(previous[:, None] - detected, axis=2)
        nearest = away_px.argmin(axis=1)
        for i, j in enumerate(nearest):
            if away_px[:, j].argmin() == i and away_px[i, j] <= proximity_px:
                expected[i] = j
    np.testing.assert_array_equal(associate(previous, detected, proximity_px), expected)
