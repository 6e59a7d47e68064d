"""The grid finder on turned, bent, jittered, incomplete and polluted grids."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.finding.grid import ABSENT, expected_places, find_grid

SIZE = (640, 480)


def lattice(
    rows: int, columns: int, pitch_px: float = 37.0, *, turn_deg: float = 0.0
) -> np.ndarray:
    row, column = np.divmod(np.arange(rows * columns), columns)
    x = (column - (columns - 1) / 2) * pitch_px
    y = (row - (rows - 1) / 2) * pitch_px
    angle = np.deg2rad(turn_deg)
    turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    return np.column_stack(turned) + np.array(SIZE) / 2


def assert_sorted(points: np.ndarray, shape: tuple[int, int], seed: int = 0) -> None:
    order = np.random.default_rng(seed).permutation(len(points))
    grid = find_grid(points[order], SIZE)
    assert grid.shape == shape
    np.testing.assert_array_equal(order[grid.point], np.arange(len(points)))


@pytest.mark.parametrize("shape", [(8, 8), (7, 10), (4, 5), (1, 6), (5, 1), (1, 1), (2, 2), (1, 2)])
@pytest.mark.parametrize("turn_deg", [-15.0, 0.0, 9.0, 15.0])
def test_sizes_and_turns(shape: tuple[int, int], turn_deg: float) -> None:
    assert_sorted(lattice(*shape, turn_deg=turn_deg), shape)


@pytest.mark.parametrize("seed", range(10))
def test_jitter_and_bending(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(7, 10, turn_deg=rng.uniform(-12, 12)) + rng.normal(0, 2.5, (70, 2))
    radial = (points - np.array(SIZE) / 2) / 320
    bend = rng.uniform(-0.15, 0.15)
    bent = radial * (1 + bend * (radial**2).sum(axis=1, keepdims=True))
    tilted = bent / (1 + 0.12 * bent[:, :1])
    assert_sorted(tilted * 320 + np.array(SIZE) / 2, (7, 10), seed)


def test_unequal_pitches() -> None:
    points = lattice(6, 6, turn_deg=10.0)
    assert_sorted((points - points.mean(axis=0)) * (1.0, 1.5) + (320, 240), (6, 6))
    assert_sorted((points - points.mean(axis=0)) * (1.4, 0.9) + (320, 240), (6, 6))


@pytest.mark.parametrize("seed", range(10))
def test_missing_markers_are_named(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(8, 8, turn_deg=rng.uniform(-10, 10)) + rng.normal(0, 0.8, (64, 2))
    lost = np.sort(rng.choice(64, 4, replace=False))
    order = rng.permutation(np.setdiff1d(np.arange(64), lost))
    grid = find_grid(points[order], SIZE)
    assert grid.shape == (8, 8)
    np.testing.assert_array_equal(grid.missing, lost)
    assert np.hypot(*(grid.expected_px[lost] - points[lost]).T).max() < 6.0
    there = grid.point != ABSENT
    np.testing.assert_array_equal(order[grid.point[there]], np.flatnonzero(there))


@pytest.mark.parametrize("seed", range(10))
def test_stray_points_are_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(7, 8)
    centre = points[rng.choice(56, 3, replace=False)] + np.array([18.0, 18.0])
    far = np.array([[20.0, 20.0], [600.0, 30.0]])
    grid = find_grid(np.vstack([points, centre, far]), SIZE)
    assert grid.shape == (7, 8)
    np.testing.assert_array_equal(grid.point, np.arange(56))
    assert grid.stray == list(range(56, 61))


def test_a_row_that_leaves_the_sensor_is_not_missed() -> None:
    points = lattice(8, 8, 68.0, turn_deg=5.0)
    inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
    grid = find_grid(points[inside], SIZE)
    assert grid.shape[1] == 8
    assert len(grid.missing) == 0
    assert grid.shape[0] in (6, 7)


def test_a_known_size_is_placed_where_it_fits() -> None:
    points = np.delete(lattice(8, 8), np.arange(7), axis=0)
    grid = find_grid(points, SIZE, (8, 8))
    np.testing.assert_array_equal(grid.missing, np.arange(7))
    assert find_grid(points, SIZE).shape == (7, 8)


def test_nothing_to_find() -> None:
    with pytest.raises(CalibrationError, match="no candidate"):
        find_grid(np.empty((0, 2)), SIZE)


def test_a_marker_is_expected_where_the_bent_grid_of_the_others_has_it() -> None:
    places = lattice(5, 7)
    away = (places - np.array(SIZE) / 2) / 320
    bent = places - 24.0 * away * (away**2).sum(axis=1, keepdims=True)  # barrel distortion
    known = np.ones(35, bool)
    known[[0, 17]] = False
    shown = bent.copy()
    shown[~known] = -50.0
    expected = expected_places(shown, known, (5, 7))
    np.testing.assert_allclose(expected[~known], bent[~known], atol=0.1)
    three = np.zeros(35, bool)
    three[[0, 6, 34]] = True
    np.testing.assert_allclose(expected_places(places, three, (5, 7)), places, atol=1e-6)
