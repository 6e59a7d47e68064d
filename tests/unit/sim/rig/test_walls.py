"""Walls and bits: distances, normals, and the radius with which a hexagon really touches."""

import numpy as np
import pytest

from spikingtac.sim.rig.walls import HexBit


def test_a_hexagon_touches_with_a_mean_radius_of_041() -> None:
    heading = np.linspace(0.0, np.pi / 3, 1000, endpoint=False)
    reach = [HexBit(heading_rad=h).points_mm[:, 0].max() for h in heading]
    assert min(reach) == pytest.approx(0.375, abs=1e-4)
    assert max(reach) == pytest.approx(0.433, abs=1e-3)
    assert np.mean(reach) == pytest.approx(0.4135, abs=1e-3)
