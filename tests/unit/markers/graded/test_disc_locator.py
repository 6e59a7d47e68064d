"""The disc fit as the tracker uses it; its kernels have their twins in ``naive``."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.disc_locator import DiscLocator, DiscLocatorConfig
from spikingtac.state_map.graded import GradedStateMap

SIZE = (80, 60)
CENTER_PX = np.array([[40.0, 30.0]])
RADIUS_PX = np.array([7.0])
SOFT_EDGE_PX = 1.5
"""So soft that an uncut step from 6 px away is 3.6 px long."""
LINEAR_PX = 2.0
"""Beyond this the edge model is not linear: a step of the fit is cut to it."""


@pytest.mark.parametrize("away_px", [4.0, 6.0, 8.0])
def test_one_step_goes_no_farther_than_the_edge_is_linear(away_px: float) -> None:
    calibration = Calibration(
        reference_px=CENTER_PX,
        radius_px=RADIUS_PX,
        grid=(1, 1),
        size=SIZE,
        contrast=6.0,
        edge_px=SOFT_EDGE_PX,
    )
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    distance_px = np.hypot(x - CENTER_PX[0, 0], y - CENTER_PX[0, 1])
    level = DiscProfile(6.0, SOFT_EDGE_PX).level(distance_px - RADIUS_PX[0])
    locator = DiscLocator(DiscLocatorConfig(iterations=1, grid_weight=0.0), calibration)
    start_px = CENTER_PX + np.array([0.6, -0.8]) * away_px
    found_px, _ = locator.locate(GradedStateMap(level.astype(np.float32)), start_px, None, 0.0)
    step_px = found_px - start_px
    assert np.linalg.norm(step_px) == pytest.approx(LINEAR_PX)
    np.testing.assert_allclose(step_px / LINEAR_PX, [[-0.6, 0.8]], atol=0.05)
