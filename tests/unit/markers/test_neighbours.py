from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.neighbours import neighbour_weights, smallest_spacing_px

GRID_PX = np.stack(np.meshgrid(np.arange(5) * 30.0, np.arange(4) * 28.0), -1).reshape(-1, 2)


def test_affine_motion_is_predicted_exactly() -> None:
    matrix = np.array([[0.05, -0.2], [0.15, 0.02]])
    displacement = GRID_PX @ matrix.T + [3.0, -1.0]
    predicted = neighbour_weights(GRID_PX) @ displacement
    np.testing.assert_allclose(predicted, displacement, atol=0.05)


def test_nobody_votes_on_himself() -> None:
    weights = neighbour_weights(GRID_PX)
    np.testing.assert_array_equal(np.diag(weights), 0.0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)


def test_markers_on_a_line_and_alone() -> None:
    line = np.stack([np.arange(6) * 20.0, np.zeros(6)], axis=1)
    weights = neighbour_weights(line)
    np.testing.assert_allclose(weights @ np.arange(6.0), np.arange(6.0), atol=0.1)
    assert neighbour_weights(line[:1]).tolist() == [[1.0]]


def test_smallest_spacing() -> None:
    assert smallest_spacing_px(GRID_PX) == pytest.approx(28.0)
    assert smallest_spacing_px(GRID_PX[:1]) == np.inf
