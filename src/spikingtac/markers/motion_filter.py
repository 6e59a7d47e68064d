"""A constant-velocity Kalman filter per marker, and the correction of the sensor's lag.

White acceleration noise of density q (px^2/s^3) drives each axis; the fit measures the position
with standard deviation sigma once per ms. Faster estimates read nearly the same map, so that their
variance grows as their period shrinks. The covariance is shared by all markers, since all are
measured at the same times; a coasted marker stays where it is put. The output is c + lag * v: what
the events show now is where the marker was ``lag`` ago.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

ACCELERATION_NOISE_PX2_S3 = 5.0e5
"""Ours: finger motion and releases reach 1e4 px/s^2 within tens of ms, rests none."""

MEASUREMENT_SIGMA_PX = 0.05
"""Scatter of a fit from one ms to the next (ours, measured: 0.03 to 0.06)."""

MEASUREMENT_PERIOD_S = 1.0e-3
"""Time in which the map changes enough for the next measurement to be a new one."""

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
        self._dt_s = MEASUREMENT_PERIOD_S

    def predict(self, dt_s: float) -> NDArray[np.float64]:
        """Move the state on by ``dt_s`` and return the predicted positions (a view)."""
        pp, pv, vv = self._covariance
        q = ACCELERATION_NOISE_PX2_S3
        self._covariance = (
            pp + dt_s * (2.0 * pv + dt_s * vv) + q * dt_s**3 / 3.0,
            pv + dt_s * vv + q * dt_s**2 / 2.0,
            vv + q * dt_s,
        )
        self._dt_s = dt_s
        self.position_px += dt_s * self.velocity_px_s
        return self.position_px

    def update(self, measured_px: NDArray[np.float64], coasted: NDArray[np.bool_]) -> None:
        """Take in measured positions; coasted markers keep their prediction, at no speed."""
        pp, pv, vv = self._covariance
        shortness = max(1.0, MEASUREMENT_PERIOD_S / max(self._dt_s, 1e-6))
        total = pp + MEASUREMENT_SIGMA_PX**2 * shortness
        gains = pp / total, pv / total
        _correct_kernel(self.position_px, self.velocity_px_s, measured_px, coasted, gains)
        self._covariance = ((1.0 - gains[0]) * pp, (1.0 - gains[0]) * pv, vv - gains[1] * pv)

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.position_px[marker] = position_px
        self.velocity_px_s[marker] = 0.0


@njit(cache=True, nogil=True)
def _correct_kernel(
    position_px: NDArray[np.float64],
    velocity_px_s: NDArray[np.float64],
    measured_px: NDArray[np.float64],
    coasted: NDArray[np.bool_],
    gains: tuple[float, float],
) -> None:  # pragma: no cover - compiled
    for m in range(position_px.shape[0]):
        for axis in range(2):
            if coasted[m]:
                velocity_px_s[m, axis] = 0.0
            else:
                innovation = measured_px[m, axis] - position_px[m, axis]
                position_px[m, axis] += gains[0] * innovation
                velocity_px_s[m, axis] += gains[1] * innovation
