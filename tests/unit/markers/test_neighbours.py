import numpy as np

from spikingtac.markers.neighbours import (
    FARTHEST_PITCHES,
    Neighbourhood,
    settle_kernel,
)

GRID_PX = np.stack(np.meshgrid(np.arange(5) * 30.0, np.arange(4) * 28.0), -1).reshape(-1, 2)


def shrunk(neighbours: Neighbourhood, position_px: np.ndarray, noise_px: np.ndarray) -> np.ndarray:
    return settled(neighbours, position_px, noise_px)[0]


def settled(
    neighbours: Neighbourhood, position_px: np.ndarray, noise_px: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    out, outside = np.empty_like(position_px), np.empty(len(position_px), np.bool_)
    limits = noise_px, neighbours.own_share, neighbours.bound_px
    settle_kernel(position_px, neighbours.skin, limits, out, outside)
    return out, outside


def test_affine_motion_is_predicted_exactly_within_the_neighbours_range() -> None:
    matrix = np.array([[0.05, -0.2], [0.15, 0.02]])
    moved_px = GRID_PX + GRID_PX @ matrix.T + [3.0, -1.0]
    neighbours = Neighbourhood(GRID_PX)
    predicted_px = neighbours.expected_px(moved_px)
    inside = [6, 7, 8, 11, 12, 13]
    np.testing.assert_allclose(predicted_px[inside], moved_px[inside], atol=0.05)
    around = (moved_px - GRID_PX)[neighbours.index]
    shift = predicted_px - GRID_PX
    assert (shift >= around.min(axis=1) - 1e-9).all()
    assert (shift <= around.max(axis=1) + 1e-9).all()


def test_the_kernels_equal_their_twins() -> None:
    rng, neighbours = np.random.default_rng(3), Neighbourhood(GRID_PX)
    moved_px = GRID_PX + rng.normal(0.0, 6.0, GRID_PX.shape)
    moved_px[:10] = GRID_PX[:10] + rng.normal(0.0, 0.3, (10, 2))
    noise_px = rng.uniform(0.05, 0.4, len(GRID_PX))
    shift = moved_px - GRID_PX
    around = shift[neighbours.index]
    low, high = around.min(axis=1), around.max(axis=1)
    expected = (neighbours.weight[:, :, None] * around).sum(axis=1)
    np.testing.assert_allclose(
        neighbours.expected_px(moved_px), GRID_PX + np.clip(expected, low, high), atol=1e-12
    )
    apart, beyond = shift - expected, shift - np.clip(shift, low, high)
    own = 1.0 / (1.0 + (neighbours.weight**2).sum(axis=1))
    taken = own * noise_px**2 / ((apart**2).sum(axis=1) + noise_px**2)
    length = np.hypot(*beyond.T)
    out = length > neighbours.bound_px
    back = 1.0 - neighbours.bound_px / np.maximum(length, 1e-9)
    settled_px = moved_px - np.where(out[:, None], back[:, None] * beyond, taken[:, None] * apart)
    place_px, outside = settled(neighbours, moved_px, noise_px)
    np.testing.assert_allclose(neighbours.bound_px, FARTHEST_PITCHES * 28.0)
    np.testing.assert_allclose(place_px, settled_px, atol=1e-9)
    np.testing.assert_array_equal(outside, out)
    assert 0 < out.sum() < len(GRID_PX)
    changed_px = np.hypot(*(place_px - moved_px).T)[~out]
    assert (changed_px <= 0.5 * noise_px[~out] + 1e-9).all()


def test_shrinkage_keeps_contacts_and_rigid_motion() -> None:
    neighbours, noise_px = Neighbourhood(GRID_PX), np.full(len(GRID_PX), 0.1)
    turned_px = GRID_PX @ np.array([[1.0, 0.05], [-0.05, 1.0]]) + [4.0, -2.0]
    np.testing.assert_allclose(shrunk(neighbours, turned_px, noise_px), turned_px, atol=0.01)
    pressed_px = GRID_PX.copy()
    pressed_px[7] += [5.0, 0.0]
    moved_px = shrunk(neighbours, pressed_px, noise_px)[7]
    np.testing.assert_allclose(moved_px, pressed_px[7], atol=0.01)


def test_markers_on_a_line_and_alone() -> None:
    line = np.stack([np.arange(6) * 20.0, np.zeros(6)], axis=1)
    stretched = line * 1.1
    expected_px = Neighbourhood(line).expected_px(stretched)
    np.testing.assert_allclose(expected_px[1:-1], stretched[1:-1], atol=0.5)
    np.testing.assert_allclose(expected_px[[0, -1], 0], [2.0, 108.0])  # within their range
    alone_px = np.array([[4.0, 5.0]])
    alone = Neighbourhood(line[:1])
    np.testing.assert_array_equal(alone.expected_px(alone_px), alone_px)
    np.testing.assert_array_equal(shrunk(alone, alone_px, np.array([0.2])), alone_px)
