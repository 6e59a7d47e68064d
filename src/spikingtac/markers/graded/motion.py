"""The motion of markers: constant-velocity Kalman filters, and the flat states that they fill.

White acceleration noise of density q (px^2/s^3) drives both axes; a fit measures the position with
standard deviation sigma once per ms. Faster estimates read nearly the same map, so that their
variance grows as their period shrinks.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import nearest_marker
from spikingtac.state_map.graded import Array, GradedStateMap

# Finger motion and releases reach 1e4 px/s^2 within tens of ms, rests none.
ACCELERATION_NOISE_PX2_S3 = 5.0e5

# Scatter of a fit from one ms to the next (measured: 0.03 to 0.06).
MEASUREMENT_SIGMA_PX = 0.05

# Time in which the map changes enough for the next measurement to be a new one.
MEASUREMENT_PERIOD_S = 1.0e-3

START_VELOCITY_PX_S = 100.0  # Standard deviation of the unknown velocity at the first estimate.

# Fewer events are looked at after this time, us: as long as a prediction serves (at 6 ms,
# 10,000 estimates a second err by 7 % more on v2e's recording).
LATE_US = 2_000

# Shortest time between two fits to dead bands, us: in less too few pixels fire to tell a place.
SHORTEST_PERIOD_US = 1_000

AT_ONCE = 1 << 30  # Events that are due for any marker.

# Columns of a motion: place, px; velocity, px/s; the covariance of both axes; its time, us.
X, Y, VX, VY, PP, PV, VV, AT_US = range(8)

# Columns of a fit: place, px; its time, us; share of the edge that agrees with the disc; until
# when no event changed it, us; where the marker stood when its pixels were marked, px; when its
# outline was fitted last, us.
FIT_X, FIT_Y, FIT_US, AGREEMENT, SILENT_US, MARKED_X, MARKED_Y, OUTLINED_US = range(8)


def resting_motion(position_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(m, 8)`` motions of markers that rest somewhere, px, from a time not yet known."""
    motion = np.zeros((len(position_px), 8))
    motion[:, X:VX] = position_px
    motion[:, PP], motion[:, VV] = MEASUREMENT_SIGMA_PX**2, START_VELOCITY_PX_S**2
    motion[:, AT_US] = -1.0
    return motion


@njit(cache=True, nogil=True, forceinline=True)
def predict_kernel(motion: Array, dt_s: float) -> None:  # pragma: no cover
    """Move one marker's state on by ``dt_s``."""
    pp, pv, vv, q = motion[PP], motion[PV], motion[VV], ACCELERATION_NOISE_PX2_S3
    motion[X] += dt_s * motion[VX]
    motion[Y] += dt_s * motion[VY]
    motion[PP] = pp + dt_s * (2.0 * pv + dt_s * vv) + q * dt_s**3 / 3.0
    motion[PV] = pv + dt_s * vv + 0.5 * q * dt_s**2
    motion[VV] = vv + q * dt_s


@njit(cache=True, nogil=True, forceinline=True)
def correct_kernel(motion: Array, x: float, y: float, dt_s: float) -> None:  # pragma: no cover
    """Take in one marker's measured place, px, ``dt_s`` after the last."""
    pp, pv = motion[PP], motion[PV]
    shortness = max(1.0, MEASUREMENT_PERIOD_S / max(dt_s, 1e-6))
    total = pp + MEASUREMENT_SIGMA_PX**2 * shortness
    near, speed = pp / total, pv / total
    off_x, off_y = x - motion[X], y - motion[Y]
    motion[X] += near * off_x
    motion[Y] += near * off_y
    motion[VX] += speed * off_x
    motion[VY] += speed * off_y
    motion[PP], motion[PV] = (1.0 - near) * pp, (1.0 - near) * pv
    motion[VV] -= speed * pv


@njit(cache=True, nogil=True, forceinline=True)
def asks_kernel(
    m: int, fits: Array, pending: Array, due: Array, turns: tuple[int, int, bool, int]
) -> bool:  # pragma: no cover - compiled
    """Return whether a marker asks for a fit, and note since when it has been silent.

    ``turns`` is the period, the one after the last marker, whether bands are fitted, and the time.
    """
    period_us, after, dead_bands, t_us = turns
    if pending[m] == 0:
        fits[m, SILENT_US] = t_us
    asked = pending[m] >= due[0, m] or t_us - fits[m, SILENT_US] >= LATE_US
    if dead_bands:
        asked = asked and t_us - fits[m, FIT_US] >= SHORTEST_PERIOD_US
    elif asked and period_us and pending[m] < due[1, m]:
        asked = fits[m, FIT_US] < t_us - (t_us + m * period_us // after) % period_us
    return asked


class Locator:
    """The states of one sensor's markers, and the map that tells of them.

    Attributes:
        map: The map that it reads.
        motion: ``(m, 8)`` states of the markers by the columns above.
        fits: ``(m, 8)`` what was fitted last, by the columns above.
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
        pending: ``(m + 1,)`` events around each marker since its last fit, and those around none:
            so no event needs a branch, which would cost half as much again.
        busy: Whether half of the markers or more were fitted last.
        counts: ``(m,)`` events in each marker's cell, nearest to its rest, since they were taken.
    """

    def __init__(self, calibration: Calibration, state_map: GradedStateMap) -> None:
        """Begin at rest."""
        self._start_px = calibration.reference_px.astype(np.float64)
        self._radius_px = calibration.radius_px.astype(np.float64)
        self._cell = nearest_marker(calibration.reference_px, calibration.size)
        self.map = state_map
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        count = len(self._start_px)
        self.map.reset()
        self.motion = resting_motion(self._start_px)
        self.fits = np.zeros((count, 8))
        self.fits[:, :FIT_US] = self._start_px
        self.fits[:, MARKED_X : MARKED_Y + 1] = self._start_px
        self.fits[:, AGREEMENT] = 1.0
        self.outline_px = np.column_stack([self._radius_px, np.zeros((count, 2))])
        self.pending, self.counts = np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
        self.busy = False

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.motion[marker, X:VX] = position_px[marker]
        self.motion[marker, VX : VX + 2] = 0.0
        self.pending[:-1][marker] = AT_ONCE
