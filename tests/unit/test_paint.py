"""Painted discs, and the paper's figure: a marker is rebuilt once it has moved by its diameter."""

import numpy as np
import pytest

from spikingtac.markers.blobs import find_blobs
from spikingtac.state_map.binary import BinaryStateMap, paint_binary_discs, paint_discs
from stand_ins.ideal_events import ideal_events

SIZE = (80, 60)
RADIUS_PX = 7.0
START_PX = np.array([25.0, 30.0])
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


@pytest.mark.parametrize("center", [(0, 0), (39, 29), (-3, 10), (200, 10), (5, -90)])
def test_discs_at_and_beyond_the_border_are_cut(center: tuple[float, float]) -> None:
    painted = paint_discs((40, 30), np.array([center]), np.array([5.0]))
    np.testing.assert_allclose(
        painted.sum(), exact_cover((40, 30), np.array(center), 5.0).sum(), rtol=0.05, atol=0.3
    )


def rebuilt(diameters: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    steps = 200
    direction = np.array([np.cos(angle), np.sin(angle)])
    travel = np.linspace(0.0, diameters * 2.0 * RADIUS_PX, steps)
    path = (START_PX + travel[:, None] * direction)[:, None, :]
    state_map = BinaryStateMap(SIZE)
    state_map.absorb(ideal_events(path, RADIUS_PX, SIZE))
    return state_map.values, path[-1]


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4])
def test_a_marker_is_rebuilt_from_nothing_after_its_diameter(angle: float) -> None:
    values, end = rebuilt(1.1, angle)
    blobs = find_blobs(values)
    assert len(blobs.area_px) == 1
    ideal = paint_binary_discs(SIZE, blobs.center_px, np.array([RADIUS_PX]))
    agreement = np.minimum(values, ideal).sum() / np.maximum(values, ideal).sum()
    assert agreement > 0.85, "intersection over union with a whole disc at its place"
    assert blobs.area_px[0] == pytest.approx(np.pi * RADIUS_PX**2, rel=0.1)
    assert np.hypot(*(blobs.center_px[0] - end[0])) < 1.2
