"""The protocol of locators: disc fit, band fit or centroid."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.state_map.graded import GradedStateMap


class Locator(Protocol):
    """Finds each marker in the graded map, near where it is expected.

    Attributes:
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
    """

    outline_px: NDArray[np.float64]

    def locate(
        self,
        state_map: GradedStateMap,
        predicted_px: NDArray[np.float64],
        expected_px: NDArray[np.float64] | None,
        dt_s: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``(m, 2)`` centres, px, and ``(m,)`` agreement with the map, 0 to 1.

        Args:
            state_map: The map.
            predicted_px: ``(m, 2)`` where the motion leads, px.
            expected_px: ``(m, 2)`` where the neighbours expect each marker, px, if
                :attr:`needs_expectation`.
            dt_s: Time since the last call, s.
        """
        ...

    def initial_map(self, calibration: Calibration) -> GradedStateMap:
        """Return the map of the sensor at rest, of the kind that this locator reads."""
        ...

    def reset(self) -> None:
        """Forget everything but the calibration."""
        ...

    @property
    def needs_expectation(self) -> bool:
        """True where the neighbours' prediction takes part in the estimate."""
        ...

    @property
    def largest_fall(self) -> float:
        """By how much the agreement of a fit that follows its marker falls at most; inf: any."""
        ...
