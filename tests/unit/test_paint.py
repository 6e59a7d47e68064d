from __future__ import annotations

import numpy as np
import pytest

from spikingtac.state_map.binary import paint_binary_discs, paint_discs

CENTER = np.array([[20.3, 14.6]])
SUBSAMPLES = 20


def exact_cover(size: tuple[int, int], center: np.ndarray, radius: float) -> np.ndarray:
    fine = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    x = (np.arange(size[0])[:, None] + fine).ravel() - center[0]
    y = (np.arange(size[1])[:, None] + fine).ravel() - center[1]
    inside = (np.hypot(x[None, :], y[:, None]) < radius).astype(float)
    return inside.reshape(size[1], SUBSAMPLES, size[0], SUBSAMPLES).mean(axis=(1, 3))


@pytest.mark.parametrize("radius", [3.0, 7.25, 12.4])
def test_the_cover_is_near_the_exact_one(radius: float) -> None:
    painted = paint_discs((40, 30), CENTER, np.array([radius]))
    exact = exact_cover((40, 30), CENTER[0], radius)
    assert np.abs(painted - exact).max() < 0.1
    assert painted.sum() == pytest.approx(exact.sum(), rel=0.02)
    total = painted.sum()
    y, x = np.mgrid[:30, :40]
    center = np.array([(painted * x).sum() / total, (painted * y).sum() / total])
    np.testing.assert_allclose(center, CENTER[0], atol=0.02)


def test_binary_discs_hold_the_covered_pixel_centres() -> None:
    painted = paint_binary_discs((40, 30), CENTER, np.array([6.0]))
    y, x = np.mgrid[:30, :40]
    inside = np.hypot(x - CENTER[0, 0], y - CENTER[0, 1]) <= 6.0
    np.testing.assert_array_equal(painted, inside.astype(np.float32))


@pytest.mark.parametrize("center", [(0, 0), (39, 29), (-3, 10), (200, 10), (5, -90)])
def test_discs_at_and_beyond_the_border_are_cut(center: tuple[float, float]) -> None:
    painted = paint_discs((40, 30), np.array([center]), np.array([5.0]))
    np.testing.assert_allclose(
        painted.sum(), exact_cover((40, 30), np.array(center), 5.0).sum(), rtol=0.05, atol=0.3
    )
