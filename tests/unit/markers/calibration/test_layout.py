"""The layout finder on turned, staggered, bent, jittered, incomplete and polluted layouts."""

import numpy as np
import pytest

from spikingtac.markers.calibration.layout import ABSENT, find_layout

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
    grid = find_layout(points[order], SIZE)
    assert grid.shape == shape
    np.testing.assert_array_equal(order[grid.point], np.arange(len(points)))


@pytest.mark.parametrize("shape", [(8, 8), (7, 10), (4, 5), (1, 6), (5, 1), (2, 2), (1, 2)])
@pytest.mark.parametrize("turn_deg", [-40.0, -15.0, 0.0, 9.0, 28.0])
def test_sizes_and_turns(shape: tuple[int, int], turn_deg: float) -> None:
    assert_sorted(lattice(*shape, turn_deg=turn_deg), shape)


@pytest.mark.parametrize("seed", range(10))
def test_jitter_and_bending(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(7, 10, turn_deg=rng.uniform(-12, 12)) + rng.normal(0, 2.0, (70, 2))
    radial = (points - np.array(SIZE) / 2) / 320
    bend = rng.uniform(-0.5, 0.3)
    bent = radial * (1 + bend * (radial**2).sum(axis=1, keepdims=True))
    tilted = bent / (1 + 0.12 * bent[:, :1])
    assert_sorted(tilted * 320 + np.array(SIZE) / 2, (7, 10), seed)


@pytest.mark.parametrize("seed", range(10))
def test_missing_markers_are_named(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(8, 8, turn_deg=rng.uniform(-10, 10)) + rng.normal(0, 0.8, (64, 2))
    corners = [0, 7, 56, 63]  # of a turned grid the image may have cut them off
    lost = np.sort(rng.choice(np.setdiff1d(np.arange(64), corners), 4, replace=False))
    order = rng.permutation(np.setdiff1d(np.arange(64), lost))
    grid = find_layout(points[order], SIZE)
    assert grid.shape == (8, 8)
    np.testing.assert_array_equal(np.flatnonzero(grid.point == ABSENT), lost)
    assert np.hypot(*(grid.expected_px[lost] - points[lost]).T).max() < 6.0
    there = grid.point != ABSENT
    np.testing.assert_array_equal(order[grid.point[there]], np.flatnonzero(there))


def test_a_silent_corner_of_a_turned_grid_is_missing() -> None:
    points = np.delete(lattice(9, 9, turn_deg=8.0), [62, 70, 71, 78, 79, 80], axis=0)
    assert find_layout(points, SIZE).shape == (9, 9)


@pytest.mark.parametrize("seed", range(10))
def test_stray_points_are_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = lattice(7, 8)
    centre = points[rng.choice(56, 3, replace=False)] + np.array([18.0, 18.0])
    far = np.array([[20.0, 20.0], [600.0, 30.0]])
    grid = find_layout(np.vstack([points, centre, far]), SIZE)
    assert grid.shape == (7, 8)
    np.testing.assert_array_equal(grid.point, np.arange(56))
    assert grid.stray == list(range(56, 61))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("staggered", [False, True])
def test_a_turned_lattice_that_the_image_cuts_loses_and_invents_no_marker(
    seed: int, staggered: bool
) -> None:
    rng = np.random.default_rng(seed)
    pitch_px, turn = rng.uniform(20, 40), np.deg2rad(rng.uniform(0, 90) if seed else 5.0)
    row, column = (axis.ravel() for axis in np.mgrid[-20:21, -20:21].astype(float))
    down = rng.uniform(0.8, 1.1) if staggered else 1.0
    places = np.column_stack([column + (row % 2 * 0.5 if staggered else 0), row * down]) * pitch_px
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = (places + rng.uniform(0, pitch_px, 2)) @ turned + 100 + rng.normal(0, 0.5, (1681, 2))
    points = points[((points > 22) & (points < 178)).all(axis=1)]
    layout = find_layout(points, (200, 200))
    assert sorted(layout.point.tolist()) == list(range(len(points)))
    assert layout.stray == []


@pytest.mark.parametrize("turn_deg", [0.0, 12.0, -35.0])
@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_staggered_rows_are_rows(turn_deg: float, phase: float) -> None:
    row, column = np.divmod(np.arange(30), 6)
    angle = np.deg2rad(turn_deg)
    x, y = 25.0 * (column + (row / 2 + phase) % 1), 24.0 * row
    points = np.column_stack([
        np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    ]) + 100.0  # fmt: skip
    order = np.random.default_rng(0).permutation(30)
    layout = find_layout(points[order], SIZE)
    assert layout.shape == (5, 6)
    assert layout.staggered
    np.testing.assert_array_equal(order[layout.point], np.arange(30))
    assert find_layout(np.delete(points, 5, axis=0), SIZE).shape is None


def test_free_markers_have_no_rows() -> None:
    points = np.random.default_rng(1).uniform(20, 400, (23, 2))
    layout = find_layout(points, SIZE, kind="free")
    assert layout.shape is None
    assert sorted(layout.point.tolist()) == list(range(23))


def test_a_known_size_is_placed_where_it_fits() -> None:
    points = np.delete(lattice(8, 8), np.arange(7), axis=0)
    grid = find_layout(points, SIZE, (8, 8))
    np.testing.assert_array_equal(np.flatnonzero(grid.point == ABSENT), np.arange(7))
    assert find_layout(points, SIZE).shape == (7, 8)
