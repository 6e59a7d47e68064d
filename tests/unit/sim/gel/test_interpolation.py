"""Interpolation at the markers against fields that are known everywhere."""

from __future__ import annotations

import numpy as np

from spikingtac.sim.gel.layer import GridConfig, MarkerInterpolation

GRID = GridConfig()
POINTS = np.random.default_rng(1).uniform(-12.0, 12.0, (50, 2))


def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(x) * y, np.cos(0.7 * y) + x, np.exp(-0.5 * (x**2 + y**2) / 1.5**2)])


def test_smooth_fields_and_their_gradients() -> None:
    x, y = np.meshgrid(GRID.axis_mm, GRID.axis_mm)
    inside = POINTS[np.abs(POINTS).max(axis=1) < 11.5]
    moved, gradient = MarkerInterpolation(GRID, inside).at_markers(field(x, y))
    px, py = inside.T
    np.testing.assert_allclose(moved.T, field(px, py), rtol=1e-4, atol=1e-4)
    zero, one = np.zeros_like(px), np.ones_like(px)
    expected = [[np.cos(px) * py, np.sin(px)], [one, -0.7 * np.sin(0.7 * py) + zero]]
    np.testing.assert_allclose(gradient, np.transpose(expected, (2, 0, 1)), atol=2e-3)


def test_a_rotation_field_is_exact() -> None:
    x, y = np.meshgrid(GRID.axis_mm, GRID.axis_mm)
    inside = POINTS[np.abs(POINTS).max(axis=1) < 11.5]
    angle = 0.5
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    u, v = np.tensordot(turn - np.eye(2), np.stack((x, y)), axes=1)
    moved, gradient = MarkerInterpolation(GRID, inside).at_markers(np.stack((u, v, 0.0 * u)))
    np.testing.assert_allclose(inside + moved[:, :2], inside @ turn.T, atol=1e-12)
    np.testing.assert_allclose(gradient + np.eye(2), np.broadcast_to(turn, (len(inside), 2, 2)))


def test_the_grid_repeats_beyond_its_span() -> None:
    values = np.random.default_rng(2).normal(size=(3, GRID.cells, GRID.cells))
    here, slope = MarkerInterpolation(GRID, POINTS).at_markers(values)
    there, same = MarkerInterpolation(GRID, POINTS + GRID.span_mm).at_markers(values)
    np.testing.assert_allclose(here, there, atol=1e-9)
    np.testing.assert_allclose(slope, same, atol=1e-9)
