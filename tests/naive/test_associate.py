"""Association by the k-d tree against plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.blobs import UNMATCHED, associate


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
        used = match[match != UNMATCHED]
        assert len(used) == len(set(used.tolist())), "one centroid never serves two markers"
