from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.neighbours import (
    FARTHEST_PITCHES,
    Neighbourhood,
    smallest_spacing_px,
)

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


def test_shrinkage_equals_its_formula_and_is_bounded() -> None:
    rng = np.random.default_rng(4)
    neighbours = Neighbourhood(GRID_PX)
    moved_px = GRID_PX + rng.normal(0.0, 0.3, GRID_PX.shape)
    noise_px = rng.uniform(0.05, 0.4, len(GRID_PX))
    expected_px = neighbours.expected_px(moved_px)
    apart_px = moved_px - expected_px
    apart2 = (apart_px**2).sum(axis=1)
    own = 1.0 / (1.0 + (neighbours.weight**2).sum(axis=1))
    kept = 1.0 - own * noise_px**2 / (apart2 + noise_px**2)
    shrunk_px = neighbours.shrunk_px(moved_px, noise_px)
    np.testing.assert_allclose(shrunk_px, expected_px + kept[:, None] * apart_px, atol=1e-9)
    assert (np.hypot(*(shrunk_px - moved_px).T) <= 0.5 * noise_px + 1e-9).all()


def test_shrinkage_keeps_contacts_and_rigid_motion() -> None:
    neighbours, noise_px = Neighbourhood(GRID_PX), np.full(len(GRID_PX), 0.1)
    turned_px = GRID_PX @ np.array([[1.0, 0.05], [-0.05, 1.0]]) + [4.0, -2.0]
    np.testing.assert_allclose(neighbours.shrunk_px(turned_px, noise_px), turned_px, atol=0.01)
    pressed_px = GRID_PX.copy()
    pressed_px[7] += [5.0, 0.0]
    moved_px = neighbours.shrunk_px(pressed_px, noise_px)[7]
    np.testing.assert_allclose(moved_px, pressed_px[7], atol=0.01)


def test_shrinkage_of_errors() -> None:
    """Errors on a smooth field shrink by a third, and nothing is changed without noise."""
    rng = np.random.default_rng(5)
    neighbours = Neighbourhood(GRID_PX)
    true_px = GRID_PX * 1.02
    found_px = true_px + rng.normal(0.0, 0.07, (50, *GRID_PX.shape))
    noise_px = np.full(len(GRID_PX), 0.14)
    shrunk_px = np.array([neighbours.shrunk_px(one_px, noise_px) for one_px in found_px])
    before_px, after_px = np.abs(found_px - true_px).mean(), np.abs(shrunk_px - true_px).mean()
    assert after_px < 0.75 * before_px
    unchanged_px = neighbours.shrunk_px(found_px[0], np.zeros(len(GRID_PX)))
    np.testing.assert_allclose(unchanged_px, found_px[0], atol=1e-6)


def test_markers_on_a_line_and_alone() -> None:
    line = np.stack([np.arange(6) * 20.0, np.zeros(6)], axis=1)
    stretched = line * 1.1
    np.testing.assert_allclose(Neighbourhood(line).expected_px(stretched), stretched, atol=0.5)
    alone_px = np.array([[4.0, 5.0]])
    alone = Neighbourhood(line[:1])
    np.testing.assert_array_equal(alone.expected_px(alone_px), alone_px)
    np.testing.assert_array_equal(alone.shrunk_px(alone_px, np.array([0.2])), alone_px)


def test_smallest_spacing() -> None:
    assert smallest_spacing_px(GRID_PX) == pytest.approx(28.0)
    assert smallest_spacing_px(GRID_PX[:1]) == np.inf


def test_displacements_are_bounded_by_the_neighbours() -> None:
    neighbours, rng = Neighbourhood(GRID_PX), np.random.default_rng(8)
    np.testing.assert_allclose(neighbours.bound_px, FARTHEST_PITCHES * 28.0)
    moved_px = GRID_PX + rng.normal(0.0, 8.0, GRID_PX.shape)
    place_px, outside = neighbours.bounded_px(moved_px, moved_px, 1.0)
    around = (moved_px - GRID_PX)[neighbours.index]
    shift = moved_px - GRID_PX
    beyond = shift - np.clip(shift, around.min(axis=1), around.max(axis=1))
    length = np.hypot(*beyond.T)
    np.testing.assert_array_equal(outside, length > 7.0)
    cut = np.where(outside, 1.0 - 7.0 / np.maximum(length, 1e-9), 0.0)
    np.testing.assert_allclose(place_px, moved_px - cut[:, None] * beyond)
    assert 0 < outside.sum() < len(GRID_PX)
