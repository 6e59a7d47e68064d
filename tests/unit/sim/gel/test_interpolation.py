"""Interpolation at the markers against fields that are known everywhere."""

from __future__ import annotations

import numpy as np

from spikingtac.sim.layer import GridConfig, MarkerInterpolation

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
