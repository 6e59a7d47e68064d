"""Walls and bits: distances, normals, and the radius with which a hexagon really touches."""

import numpy as np
import pytest

from spikingtac.sim.rig.walls import HexBit, HoleWall, PlaneWall


def test_gap_gradient_is_the_normal() -> None:
    rng = np.random.default_rng(0)
    for wall in (
        PlaneWall(normal=(1.0, 2.0, -0.5)),
        HoleWall(radius_mm=3.0, axis=(0.1, -0.2, 1.0)),
    ):
        point = rng.normal(size=(1, 3))
        _, normal = wall.gap(point)
        for axis in range(3):
            step = np.zeros((1, 3))
            step[0, axis] = 1e-6
            slope = (wall.gap(point + step)[0] - wall.gap(point - step)[0]) / 2e-6
            assert slope[0] == pytest.approx(normal[0, axis], abs=1e-6)
            turn = (wall.gap(point + step)[1] - wall.gap(point - step)[1]) / 2e-6
            np.testing.assert_allclose(-turn[0], wall.curvature(point)[0, :, axis], atol=1e-6)


def test_a_hexagon_touches_with_a_mean_radius_of_041() -> None:
    heading = np.linspace(0.0, np.pi / 3, 1000, endpoint=False)
    reach = [HexBit(heading_rad=h).points_mm[:, 0].max() for h in heading]
    assert min(reach) == pytest.approx(0.375, abs=1e-4)
    assert max(reach) == pytest.approx(0.433, abs=1e-3)
    assert np.mean(reach) == pytest.approx(0.4135, abs=1e-3)
