"""When the map does not leak; the kernels of the leak have their twins in ``naive``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.disc_locator import LARGEST_FALL, DiscLocator, DiscLocatorConfig
from spikingtac.markers.graded.map_leak import ALL_LEVELS, USUAL_S, LeakTolerances
from spikingtac.markers.graded.tracker import GradedTracker
from spikingtac.markers.maintenance_config import MaintenanceConfig
from spikingtac.state_map.graded import GradedStateMap
from stand_ins.camera_stage import CENTERS, RADIUS_PX, SIZE

KNOWN, WARY = np.array([0.04, 0.05]), np.array([0.14, 0.15])
STEP_S = 0.004
CALIBRATION = Calibration(
    reference_px=CENTERS, radius_px=np.full(4, RADIUS_PX), grid=(2, 2), size=SIZE, contrast=6.0
)


def test_nothing_leaks_around_a_marker_whose_agreement_has_just_fallen() -> None:
    tolerances = LeakTolerances(KNOWN, WARY, LARGEST_FALL)
    usual = np.array([0.98, 0.70])
    np.testing.assert_array_equal(tolerances.update(usual, STEP_S, 0.0), KNOWN)
    np.testing.assert_array_equal(tolerances.update(usual, STEP_S, 1.0), WARY)
    np.testing.assert_allclose(tolerances.update(usual, STEP_S, 0.5), 0.5 * (KNOWN + WARY))
    fallen = usual - [2.0 * LARGEST_FALL, 0.5 * LARGEST_FALL]
    found = tolerances.update(fallen, STEP_S, 0.0)
    np.testing.assert_array_equal(found, [ALL_LEVELS, KNOWN[1]])


def test_an_agreement_that_stays_low_becomes_usual() -> None:
    tolerances = LeakTolerances(KNOWN, WARY, LARGEST_FALL)
    tolerances.update(np.ones(2), STEP_S, 0.0)
    fallen = np.full(2, 1.0 - 2.0 * LARGEST_FALL)
    waited_s = 0.0
    while (tolerances.update(fallen, STEP_S, 0.0) == ALL_LEVELS).all():
        waited_s += STEP_S
    # It falls to the half of the way in ln 2 time constants.
    np.testing.assert_allclose(waited_s, np.log(2.0) * USUAL_S, atol=2 * STEP_S)


class Still(DiscLocator):
    """Finds every marker where it is expected, with an agreement that the test sets."""

    agreement = np.ones(4)

    def locate(
        self,
        state_map: GradedStateMap,
        predicted_px: NDArray[np.float64],
        expected_px: NDArray[np.float64] | None,
        dt_s: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return predicted_px.copy(), self.agreement


def test_the_tracker_leaves_what_lies_beside_a_fallen_marker() -> None:
    locator = Still(DiscLocatorConfig(), CALIBRATION)
    tracker = GradedTracker(locator, MaintenanceConfig(), CALIBRATION)
    beside_px = np.rint(CENTERS + np.array([RADIUS_PX + 3.0, 0.0])).astype(int)
    beside = beside_px[:, 1], beside_px[:, 0]
    for t_us in range(0, 50_000, 1_000):
        tracker.estimate(t_us)
    tracker.state_map.memory[beside] += 0.9
    tracker.state_map.values[beside] += 0.9
    locator.agreement = np.array([1.0, 0.8, 1.0, 1.0])
    for t_us in range(50_000, 100_000, 1_000):
        tracker.estimate(t_us)
    left = tracker.state_map.memory[beside]
    assert left[1] > 0.85
    assert left[[0, 2, 3]].max() < 0.7
