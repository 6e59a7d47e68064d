from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.state_map.binary import BinaryStateMap, paint_binary_discs, paint_discs
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket
from spikingtac_paper.baselines.neutac import TimeSurface

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


def test_a_map_starts_painted_and_returns_to_it() -> None:
    start = paint_binary_discs((40, 30), CENTER, np.array([6.0]))
    state_map = BinaryStateMap((40, 30), start)
    np.testing.assert_array_equal(state_map.values, start)
    state_map.values[:] = 1.0
    state_map.reset()
    np.testing.assert_array_equal(state_map.values, start)


def test_a_start_of_another_shape_is_refused() -> None:
    with pytest.raises(ConfigError, match="height, width"):
        BinaryStateMap((40, 30), np.zeros((40, 30), np.float32))


@pytest.mark.parametrize(
    "state_map",
    [
        BinaryStateMap((40, 30)),
        GradedStateMap(np.zeros((30, 40), np.float32)),
        TimeSurface(np.zeros((30, 40), np.float32), 1e4),
    ],
    ids=["binary", "graded", "time surface"],
)
def test_events_of_another_sensor_are_refused(
    state_map: BinaryStateMap | GradedStateMap | TimeSurface,
) -> None:
    with pytest.raises(ConfigError, match="30x40 sensor do not fit a map of 40x30"):
        state_map.absorb(EventPacket.empty(0, 1, (30, 40)))
