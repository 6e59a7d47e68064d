"""Blob detection against scipy.ndimage, on random, structured and edge maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from spikingtac.errors import ConfigError
from spikingtac.markers.blobs import BlobConfig, BlobDetector
from spikingtac.state_map.paint import paint_binary_discs, paint_discs

EVERYTHING = BlobConfig(min_area_px=0.0, max_area_px=1e9)


def twin(state_map: np.ndarray, threshold: float) -> tuple[np.ndarray, ...]:
    bright = state_map >= np.float32(threshold)
    labels, count = ndimage.label(bright, structure=np.ones((3, 3)))
    index = np.arange(1, count + 1)
    if count == 0:
        return np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, bool)
    centers = np.array(ndimage.center_of_mass(state_map.astype(float), labels, index))[:, ::-1]
    border = np.zeros_like(bright)
    border[[0, -1], :] = border[:, [0, -1]] = True
    return (
        centers,
        ndimage.sum_labels(bright, labels, index),
        ndimage.sum_labels(state_map.astype(float), labels, index),
        ndimage.maximum(border, labels, index) > 0,
    )


def assert_equal_to_twin(state_map: np.ndarray, threshold: float) -> None:
    config = BlobConfig(threshold=threshold, min_area_px=0.0, max_area_px=1e9)
    height, width = state_map.shape
    found = BlobDetector((width, height), config).detect(state_map)
    centers, area, mass, cut = twin(state_map, threshold)
    np.testing.assert_allclose(found.center_px, centers, atol=1e-9)
    np.testing.assert_array_equal(found.area_px, area)
    np.testing.assert_allclose(found.mass, mass)
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
    assert len(BlobDetector((9, 9), EVERYTHING).detect(checkers)) == 1, "corners connect"


def test_not_a_number_is_ground() -> None:
    state_map = np.zeros((20, 20), np.float32)
    state_map[5:10, 5:10] = 1.0
    state_map[0, 0] = state_map[15, 3] = np.nan
    assert len(BlobDetector((20, 20), EVERYTHING).detect(state_map)) == 1


def test_discs_are_found_below_a_fraction_of_a_pixel() -> None:
    rng = np.random.default_rng(3)
    centers = np.stack(np.meshgrid(np.arange(20, 300, 37.0), np.arange(20, 300, 37.0)), -1)
    centers = centers.reshape(-1, 2) + rng.uniform(-0.5, 0.5, (64, 2))
    radius = np.full(64, 7.0)
    binary = BlobDetector((320, 320)).detect(paint_binary_discs((320, 320), centers, radius))
    graded = BlobDetector((320, 320), BlobConfig(threshold=0.01)).detect(
        paint_discs((320, 320), centers, radius)
    )
    for blobs, worst_px in ((binary, 0.2), (graded, 0.02)):
        assert len(blobs) == 64
        offset = np.linalg.norm(blobs.center_px[:, None] - centers[None], axis=2)
        assert offset.min(axis=0).max() < worst_px
        assert not blobs.cut.any()


def test_area_limits_and_cut_markers() -> None:
    state_map = np.zeros((30, 40), np.float32)
    state_map[2, 2] = 1.0  # noise
    state_map[0:5, 10:16] = 1.0  # cut by the border
    state_map[10:25, 10:30] = 1.0  # too large
    state_map[8:13, 33:38] = 1.0
    config = BlobConfig(min_area_px=20.0, max_area_px=100.0)
    blobs = BlobDetector((40, 30), config).detect(state_map)
    assert blobs.area_px.tolist() == [30.0, 25.0]
    assert blobs.cut.tolist() == [True, False]
    assert blobs.center_px[1].tolist() == [35.0, 10.0]


def test_results_outlive_the_next_call() -> None:
    detector = BlobDetector((20, 20), EVERYTHING)
    state_map = np.zeros((20, 20), np.float32)
    state_map[3:8, 3:8] = 1.0
    first = detector.detect(state_map)
    detector.detect(np.ones((20, 20), np.float32))
    assert first.center_px.tolist() == [[5.0, 5.0]]


def test_unfit_settings_and_maps_are_refused() -> None:
    with pytest.raises(ConfigError, match="threshold"):
        BlobConfig(threshold=0.0)
    with pytest.raises(ConfigError, match="max_area_px"):
        BlobConfig(min_area_px=5.0, max_area_px=4.0)
    with pytest.raises(ConfigError, match="made for"):
        BlobDetector((20, 30)).detect(np.zeros((20, 30), np.float32))
