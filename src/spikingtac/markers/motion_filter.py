"""A constant-velocity Kalman filter per marker, and the correction of the sensor's lag.

White acceleration noise of density q (px^2/s^3) drives each axis; the fit measures the position
with standard deviation sigma. The covariance is shared by all markers, since all are measured at
the same times with the same noise; a held marker coasts. Output c + lag * v: what the events show
now is where the marker was ``lag`` ago.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ACCELERATION_NOISE_PX2_S3 = 5.0e5
"""Ours, tuned on training recordings: releases reach 1e4 px/s^2, rests none."""

MEASUREMENT_SIGMA_PX = 0.05
"""Scatter of the disc fit from one estimate to the next (ours, measured: 0.03 to 0.06)."""

START_VELOCITY_PX_S = 100.0
"""Standard deviation of the unknown velocity at the first estimate."""


class MotionFilter:
    """Position and velocity of all markers.

    Attributes:
        position_px: ``(m, 2)`` filtered positions, px.
        velocity_px_s: ``(m, 2)`` filtered velocities, px/s.
    """

    def __init__(self, start_px: NDArray[np.float64]) -> None:
        """Begin at rest at the given positions."""
        self.position_px = start_px.astype(np.float64)
        self.velocity_px_s = np.zeros_like(self.position_px)
        self._covariance = (MEASUREMENT_SIGMA_PX**2, 0.0, START_VELOCITY_PX_S**2)

    def predict(self, dt_s: float) -> NDArray[np.float64]:
        """Move the state on by ``dt_s`` and return the predicted positions (a view)."""
        pp, pv, vv = self._covariance
        q = ACCELERATION_NOISE_PX2_S3
        self._covariance = (
            pp + dt_s * (2.0 * pv + dt_s * vv) + q * dt_s**3 / 3.0,
            pv + dt_s * vv + q * dt_s**2 / 2.0,
            vv + q * dt_s,
        )
        self.position_px += dt_s * self.velocity_px_s
        return self.position_px

    def update(self, measured_px: NDArray[np.float64], held: NDArray[np.bool_]) -> None:
        """Take in measured positions; held markers keep their prediction and lose their speed."""
        pp, pv, vv = self._covariance
        total = pp + MEASUREMENT_SIGMA_PX**2
        gain_p, gain_v = pp / total, pv / total
        innovation = measured_px - self.position_px
        innovation[held] = 0.0
        self.position_px += gain_p * innovation
        self.velocity_px_s += gain_v * innovation
        self.velocity_px_s[held] = 0.0
        self._covariance = ((1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv)

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.position_px[marker] = position_px
        self.velocity_px_s[marker] = 0.0
