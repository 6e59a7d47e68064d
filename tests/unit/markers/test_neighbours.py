from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.neighbours import Neighbourhood, smallest_spacing_px

GRID_PX = np.stack(np.meshgrid(np.arange(5) * 30.0, np.arange(4) * 28.0), -1).reshape(-1, 2)


def test_affine_motion_is_predicted_exactly() -> None:
    matrix = np.array([[0.05, -0.2], [0.15, 0.02]])
    displacement = GRID_PX @ matrix.T + [3.0, -1.0]
    predicted_px = Neighbourhood(GRID_PX).expected_px(GRID_PX + displacement)
    np.testing.assert_allclose(predicted_px, GRID_PX + displacement, atol=0.05)


def test_nobody_votes_on_himself() -> None:
    neighbours = Neighbourhood(GRID_PX)
    assert not (neighbours.index == np.arange(len(GRID_PX))[:, np.newaxis]).any()
    np.testing.assert_allclose(neighbours.weight.sum(axis=1), 1.0)


def test_kernel_equals_its_twin() -> None:
    rng = np.random.default_rng(3)
    neighbours = Neighbourhood(GRID_PX)
    moved_px = GRID_PX + rng.normal(0.0, 3.0, GRID_PX.shape)
    expected_px = [
        GRID_PX[m] + weight @ (moved_px - GRID_PX)[index]
        for m, (index, weight) in enumerate(zip(neighbours.index, neighbours.weight, strict=True))
    ]
    np.testing.assert_allclose(neighbours.expected_px(moved_px), expected_px, atol=1e-12)


def test_markers_on_a_line_and_alone() -> None:
    line = np.stack([np.arange(6) * 20.0, np.zeros(6)], axis=1)
    stretched = line * 1.1
    np.testing.assert_allclose(Neighbourhood(line).expected_px(stretched), stretched, atol=0.5)
    alone_px = np.array([[4.0, 5.0]])
    np.testing.assert_array_equal(Neighbourhood(line[:1]).expected_px(alone_px), alone_px)


def test_smallest_spacing() -> None:
    assert smallest_spacing_px(GRID_PX) == pytest.approx(28.0)
    assert smallest_spacing_px(GRID_PX[:1]) == np.inf
