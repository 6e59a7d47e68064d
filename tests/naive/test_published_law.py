"""The compiled parts of the published tracker against plain twins."""

from __future__ import annotations

import numpy as np

from spikingtac.markers.hysteresis import PaperLaw, PaperLawConfig
from spikingtac.markers.published.associate import UNMATCHED
from spikingtac.markers.published.blob_tracker import _take_kernel

MARKERS = 9


def test_the_law_equals_equations_2_to_5() -> None:
    rng = np.random.default_rng(3)
    reference_px = rng.uniform(0.0, 300.0, (MARKERS, 2))
    path = reference_px + np.cumsum(rng.normal(0.0, 1.5, (40, MARKERS, 2)), axis=0)
    law = PaperLaw(PaperLawConfig(delta_px=4.0, gamma=0.7))
    before, expected = reference_px, reference_px
    inside = 0
    for detected in path:
        distance = np.linalg.norm(detected - reference_px, axis=1)
        gain = np.where(distance >= 4.0, 1.0, 0.7)
        expected = expected + gain[:, np.newaxis] * (detected - before)
        before = detected
        inside += int((distance < 4.0).sum())
        np.testing.assert_allclose(law.update(detected.copy(), reference_px), expected, atol=1e-9)
    assert 0 < inside < path.size // 2


def test_markers_take_their_blobs() -> None:
    rng = np.random.default_rng(4)
    match = np.array([2, UNMATCHED, 0, 4, UNMATCHED, 1, 3, 6, 5])
    center_px, area_px = rng.uniform(0.0, 300.0, (7, 2)), rng.uniform(80.0, 250.0, 7)
    disc_px = rng.uniform(120.0, 180.0, MARKERS)
    detected_px = rng.uniform(0.0, 300.0, (MARKERS, 2))
    expected_px = detected_px.copy()
    held, confidence = np.empty(MARKERS, np.bool_), np.empty(MARKERS)
    _take_kernel(match, (center_px, area_px), disc_px, detected_px, held, confidence)
    found = match != UNMATCHED
    expected_px[found] = center_px[match[found]]
    share = area_px[match[found]] / disc_px[found]
    np.testing.assert_array_equal(held, ~found)
    np.testing.assert_array_equal(detected_px, expected_px)
    np.testing.assert_array_equal(confidence[~found], 0.0)
    np.testing.assert_allclose(confidence[found], np.minimum(share, 1.0 / share))
