import numpy as np

from spikingtac.markers.neighbours import FARTHEST_PITCHES, Neighbourhood

GRID_PX = np.stack(np.meshgrid(np.arange(5) * 30.0, np.arange(4) * 28.0), -1).reshape(-1, 2)


def test_affine_motion_is_predicted_exactly() -> None:
    moved_px = GRID_PX + GRID_PX @ np.array([[0.05, -0.2], [0.15, 0.02]]).T + [3.0, -1.0]
    predicted_px = Neighbourhood(GRID_PX).expected_px(moved_px)
    inside = [6, 7, 8, 11, 12, 13]
    np.testing.assert_allclose(predicted_px[inside], moved_px[inside], atol=0.05)


def test_the_kernel_equals_its_twin() -> None:
    rng, neighbours = np.random.default_rng(3), Neighbourhood(GRID_PX)
    moved_px = GRID_PX + rng.normal(0.0, 6.0, GRID_PX.shape)
    around = (moved_px - GRID_PX)[neighbours.index]
    expected = (neighbours.weight[:, :, None] * around).sum(axis=1)
    within = np.clip(expected, around.min(axis=1), around.max(axis=1))
    np.testing.assert_allclose(neighbours.expected_px(moved_px), GRID_PX + within, atol=1e-12)
    np.testing.assert_allclose(neighbours.bound_px, FARTHEST_PITCHES * 28.0)


def test_markers_on_a_line_and_alone() -> None:
    line = np.stack([np.arange(6) * 20.0, np.zeros(6)], axis=1)
    stretched = line * 1.1
    expected_px = Neighbourhood(line).expected_px(stretched)
    np.testing.assert_allclose(expected_px[1:-1], stretched[1:-1], atol=0.5)
    np.testing.assert_allclose(expected_px[[0, -1], 0], [2.0, 108.0])  # within their range
    alone_px = np.array([[4.0, 5.0]])
    np.testing.assert_array_equal(Neighbourhood(line[:1]).expected_px(alone_px), alone_px)
