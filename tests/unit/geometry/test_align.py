"""Kabsch: random rigid motions, and each degenerate case."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spikingtac_paper.holes.alignment import align


def random_rotation(rng: np.random.Generator, dimension: int) -> np.ndarray:
    if dimension == 3:
        return Rotation.from_quat(rng.normal(size=4)).as_matrix()
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [3, 4, 30])
def test_random_rigid_motions_are_found_exactly(dimension: int, count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(50):
        points = rng.normal(size=(count, dimension)) * 5.0
        rotation, shift = random_rotation(rng, dimension), rng.normal(size=dimension)
        found = align(points, points @ rotation.T + shift)
        np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
        np.testing.assert_allclose(found.translation, shift, atol=1e-8)
        assert found.rmse < 1e-9
        assert found.determined


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_mirror_image_is_not_reached_by_a_reflection(dimension: int) -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(10, dimension))
    mirrored = points * np.array([-1.0] + [1.0] * (dimension - 1))
    found = align(points, mirrored)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    assert found.rmse > 0.1


@pytest.mark.parametrize("goal", [[1.0, 0, 0], [-1.0, 0, 0], [0, 0, 1.0], [0.6, 0.8, 0]])
def test_collinear_points_turn_along_the_shortest_way(goal: list[float]) -> None:
    along = np.outer([-1.0, 0.0, 2.0], [1.0, 0.0, 0.0])
    found = align(along, np.outer([-1.0, 0.0, 2.0], goal))
    assert found.rmse < 1e-12
    assert not found.determined
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
    turned = np.degrees(Rotation.from_matrix(found.rotation).magnitude())
    assert turned == pytest.approx(np.degrees(np.arccos(goal[0])), abs=1e-5)
