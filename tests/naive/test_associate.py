"""Association by the k-d tree against plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.blobs import UNMATCHED, associate

GRID = np.stack(np.meshgrid(np.arange(20, 300, 37.0), np.arange(20, 300, 37.0)), -1).reshape(-1, 2)


def naive(previous: np.ndarray, detected: np.ndarray, proximity_px: float) -> list[int]:
    match = []
    for i, marker in enumerate(previous):
        found = UNMATCHED
        if len(detected):
            j = int(np.argmin([np.hypot(*(marker - centroid)) for centroid in detected]))
            back = int(np.argmin([np.hypot(*(other - detected[j])) for other in previous]))
            if back == i and np.hypot(*(marker - detected[j])) <= proximity_px:
                found = j
        match.append(found)
    return match


@pytest.mark.parametrize("markers", [0, 1, 2, 64])
@pytest.mark.parametrize("centroids", [0, 1, 2, 50, 300])
@pytest.mark.parametrize("proximity_px", [0.0, 8.0, 60.0, np.inf])
def test_the_tree_and_plain_python_agree(markers: int, centroids: int, proximity_px: float) -> None:
    rng = np.random.default_rng(markers + centroids)
    for _ in range(4):
        previous = rng.uniform(0, 320, (markers, 2))
        detected = rng.uniform(0, 320, (centroids, 2))
        match = associate(previous, detected, proximity_px)
        assert match.tolist() == naive(previous, detected, proximity_px)


def test_a_shaken_grid_keeps_its_identities_in_any_order_of_centroids() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        order = rng.permutation(64)
        moved = GRID + rng.uniform(-9.0, 9.0, GRID.shape)
        match = associate(GRID, moved[order], 18.0)
        assert order[match].tolist() == list(range(64))


def test_one_centroid_never_serves_two_markers() -> None:
    between = np.array([[38.0, 20.0]])
    match = associate(GRID, between, 40.0)
    assert np.flatnonzero(match != UNMATCHED).tolist() == [0]
    for seed in range(30):
        rng = np.random.default_rng(seed)
        match = associate(GRID, rng.uniform(0, 320, (40, 2)), np.inf)
        used = match[match != UNMATCHED]
        assert len(used) == len(set(used.tolist()))


def test_a_missing_marker_leaves_its_neighbours_alone() -> None:
    moved = np.delete(GRID, [9, 30], axis=0) + 5.0
    match = associate(GRID, moved, 16.0)
    assert np.flatnonzero(match == UNMATCHED).tolist() == [9, 30]
