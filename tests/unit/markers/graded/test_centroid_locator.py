"""The centroid as the tracker uses it; its kernels have their twins in ``naive``."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.centroid.centroid_locator import (
    CentroidLocator,
    CentroidLocatorConfig,
)
from spikingtac.state_map.graded import GradedStateMap

SIZE = (80, 60)
RADIUS_PX = 6.0
PROFILE = DiscProfile(4.0, 0.8)
OUTSIDE_PX = (4.0, 2.0, 0.0, -2.0, -3.5)
"""From the outermost pixels inwards: half of the disc is gone at 0, four fifths at -3.5."""


def located(true_px: tuple[float, float], start_px: tuple[float, float]) -> tuple[float, float]:
    """Return how far from the truth a disc is found, px, and its agreement."""
    calibration = Calibration(
        reference_px=np.array([[40.0, 30.0]]),
        radius_px=np.array([RADIUS_PX]),
        grid=(1, 1),
        size=SIZE,
        contrast=PROFILE.contrast,
        edge_px=PROFILE.edge_px,
    )
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = PROFILE.level(np.hypot(x - true_px[0], y - true_px[1]) - RADIUS_PX)
    locator = CentroidLocator(CentroidLocatorConfig(), calibration)
    state_map = GradedStateMap(level.astype(np.float32))
    found_px, agreement = locator.locate(state_map, np.array([start_px]), None, 0.0)
    return float(np.linalg.norm(found_px[0] - true_px)), float(agreement[0])


@pytest.mark.parametrize("inward_px", OUTSIDE_PX)
@pytest.mark.parametrize("border", ["left", "right", "top", "bottom"])
def test_a_disc_that_the_border_cuts_is_found(border: str, inward_px: float) -> None:
    along_px = 31.3
    true_px = {
        "left": (inward_px, along_px),
        "right": (SIZE[0] - 1 - inward_px, along_px),
        "top": (along_px, inward_px),
        "bottom": (along_px, SIZE[1] - 1 - inward_px),
    }[border]
    away_px, agreement = located(true_px, true_px)
    assert away_px < 0.1
    assert agreement > 0.9


@pytest.mark.parametrize("inward_px", [3.0, 0.0])
def test_a_disc_that_a_corner_cuts_is_found(inward_px: float) -> None:
    away_px, _ = located((inward_px, inward_px), (inward_px, inward_px))
    assert away_px < 0.6


def test_a_whole_disc_is_found_as_before() -> None:
    away_px, agreement = located((40.3, 29.8), (40.0, 30.0))
    assert away_px < 0.02
    assert agreement > 0.95
