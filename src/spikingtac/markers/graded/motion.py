"""Kalman filters of the markers' motion, the schedule of their fits, and the pixels of each marker.

The model is one of constant velocity: white acceleration noise of density q (px^2/s^3) drives both
axes. A disc fit measures the position with standard deviation sigma once per ms. Fits that follow
each other faster read nearly the same map, so their variance grows as their period shrinks.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.kernels import kernel
from spikingtac.state_map.graded import Array

# Density of the acceleration noise. Finger motion and releases reach 1e4 px/s^2 within tens of ms.
# (At half the density v2e's recording errs by 1 % more, its flawed gel by 0.4 % less; at twice the
# density both err by 1 % more.)
ACCELERATION_NOISE_PX2_S3 = 1.0e6

# Standard deviation of a fit's position from one ms to the next (measured: 0.03 to 0.06).
MEASUREMENT_SIGMA_PX = 0.05

# Period from which the errors of successive fits count as independent, s.
MEASUREMENT_PERIOD_S = 1.0e-3

START_VELOCITY_PX_S = 100.0  # Standard deviation of the unknown velocity at the first estimate.

# Longest time that pending events wait for a fit when they are fewer than a fit needs, us: a
# prediction is good for so long (at 6 ms, 10,000 estimates a second err by 7 % more on v2e's
# recording).
MAX_WAIT_US = 2_000

# A marker with enough pending events is fitted once per period, us, and predicted in between; the
# markers' phases are spread over the period. With 1 ms for all markers v2e's recording errs by 2 %
# less, and an estimate of markers in motion takes a third longer. The fast period holds after an
# innovation above MISSED_PX, px, and while BURST times as many events are pending as a fit
# needs: a marker would be lost at a release. Fits to dead bands always use the fast period, and no
# shorter one: in less time too few pixels fire to locate a disc.
FIT_PERIOD_US, FAST_FIT_PERIOD_US, MISSED_PX, BURST = 2_000, 1_000, 0.12, 12

FIT_NOW = 1 << 30  # Pending events that make the next estimate fit a marker, whatever its phase.

NEVER_US = -(1 << 62)  # A time before all others, us: recordings may begin before zero.

# Margin of a marker's gate beyond the edge of its disc: the largest error of a prediction, px.
# Events within the gate count for the marker.
GATE_PX = 1.0

REASSIGN_PX = 2.5  # Distance from a gate's centre at which a marker's gate is moved, px.

# A gate is moved ahead of its marker, by the motion of this time, s, and at most this distance, px.
# It serves nearly twice as long as a gate around the marker, with the same errors.
GATE_AHEAD_S, GATE_AHEAD_PX = 0.02, 2.0

# Speed up to which a marker, or the mean of all, is at rest: creep, and the jitter of a filtered
# velocity, px/s.
AT_REST_PX_S = 3.0

# What a tracker knows of one marker. (One record takes the place of 19 arrays, which every compiled
# call would be given.)
MARKER = np.dtype(
    [
        # State of the filter: position, px; velocity, px/s; variance of the position, covariance,
        # and variance of the velocity, the same for both axes; its time, us.
        *((name, np.float64) for name in ("x", "y", "vx", "vy", "var_p", "cov_pv", "var_v")),
        ("t_us", np.int64),
        # Last fit: position and length of the innovation, px; share of the edge that agrees with
        # the disc; its time, and the last time without pending events, us.
        *((name, np.float64) for name in ("fit_x", "fit_y", "innovation_px", "agreement")),
        *((name, np.int64) for name in ("fit_us", "quiet_us")),
        # Centre of the gate, px; radius at rest, px; events that a fit needs; events of late.
        *((name, np.float64) for name in ("gate_x", "gate_y", "radius_px", "needed", "recent")),
    ]
)


def resting_markers(position_px: NDArray[np.floating]) -> NDArray[np.void]:
    """Return ``(m,)`` MARKER records of markers that rest at ``(m, 2)`` positions, px."""
    markers = np.zeros(len(position_px), MARKER)
    for kind in ("", "fit_", "gate_"):
        markers[kind + "x"], markers[kind + "y"] = position_px.T
    markers["var_p"], markers["var_v"] = MEASUREMENT_SIGMA_PX**2, START_VELOCITY_PX_S**2
    markers["t_us"], markers["agreement"] = NEVER_US, 1.0
    return markers


@kernel(forceinline=True)
def predict_kernel(marker: Any, dt_s: float) -> None:  # pragma: no cover
    """Predict one marker's state ``dt_s`` later."""
    pp, pv, vv, q = marker.var_p, marker.cov_pv, marker.var_v, ACCELERATION_NOISE_PX2_S3
    marker.x += dt_s * marker.vx
    marker.y += dt_s * marker.vy
    marker.var_p = pp + dt_s * (2.0 * pv + dt_s * vv) + q * dt_s**3 / 3.0
    marker.cov_pv = pv + dt_s * vv + 0.5 * q * dt_s**2
    marker.var_v = vv + q * dt_s


@kernel(forceinline=True)
def correct_kernel(marker: Any, x: float, y: float, dt_s: float) -> None:  # pragma: no cover
    """Correct one marker's state by a measured position, px, ``dt_s`` after the last one."""
    pp, pv = marker.var_p, marker.cov_pv
    variance_factor = max(1.0, MEASUREMENT_PERIOD_S / max(dt_s, 1e-6))
    innovation_variance = pp + MEASUREMENT_SIGMA_PX**2 * variance_factor
    gain, velocity_gain = pp / innovation_variance, pv / innovation_variance
    innovation_x, innovation_y = x - marker.x, y - marker.y
    marker.x += gain * innovation_x
    marker.y += gain * innovation_y
    marker.vx += velocity_gain * innovation_x
    marker.vy += velocity_gain * innovation_y
    marker.var_p, marker.cov_pv = (1.0 - gain) * pp, (1.0 - gain) * pv
    marker.var_v -= velocity_gain * pv


@kernel(forceinline=True)
def fit_is_due_kernel(
    m: int, markers: Array, pending: int, dead_bands: bool, times_us: tuple[int, int]
) -> bool:  # pragma: no cover - compiled
    """Return whether marker m is fitted now, and note the last time without pending events.

    A fit needs ``needed`` pending events, or a wait of MAX_WAIT_US. ``times_us`` holds the time of
    the last estimate and the time of this one.
    """
    (before_us, t_us), marker = times_us, markers[m]
    if pending == 0:
        marker.quiet_us = t_us
    enough = pending >= marker.needed or t_us - marker.quiet_us >= MAX_WAIT_US
    if pending >= FIT_NOW or not enough:
        return enough
    fast = dead_bands or marker.innovation_px >= MISSED_PX or pending >= BURST * marker.needed
    period_us = FAST_FIT_PERIOD_US if fast else FIT_PERIOD_US
    # The marker's phase of the period lies between the last estimate and this one.
    return before_us < t_us - (t_us + m * period_us // len(markers)) % period_us


@kernel(forceinline=True)
def _chord_kernel(
    x: float, y: float, radius: float, row: int, width: int
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Return the first column of a row inside a circle, and the first one after them."""
    half2 = radius * radius - (row - y) ** 2
    if half2 < 0.0:
        return 0, 0
    half = np.sqrt(half2)
    return max(0, int(np.ceil(x - half))), max(0, min(width, int(np.floor(x + half)) + 1))


@kernel()
def assign_pixels_kernel(
    pixels: Array, m: int, markers: Array, outline_px: Array, edge: Array
) -> None:  # pragma: no cover - compiled
    """Centre the gate of marker m a little ahead of it: write its number into the gate's pixels.

    Pixels that leave the gate get the number of no marker. Rows are scanned once, over both the
    old gate and the new one.
    """
    radius = outline_px[m, 0] + edge[m, 1] + GATE_PX + REASSIGN_PX
    (height, width), marker = pixels.shape, markers[m]
    old_x, old_y = marker.gate_x, marker.gate_y
    x = marker.x + min(max(GATE_AHEAD_S * marker.vx, -GATE_AHEAD_PX), GATE_AHEAD_PX)
    y = marker.y + min(max(GATE_AHEAD_S * marker.vy, -GATE_AHEAD_PX), GATE_AHEAD_PX)
    marker.gate_x, marker.gate_y = x, y
    top, bottom = min(y, old_y) - radius, max(y, old_y) + radius
    for row in range(max(0, int(np.ceil(top))), min(height - 1, int(np.floor(bottom))) + 1):
        first, after = _chord_kernel(x, y, radius, row, width)
        old_first, old_after = _chord_kernel(old_x, old_y, radius, row, width)
        for left in ((old_first, min(old_after, first)), (max(old_first, after), old_after)):
            for column in range(np.uint64(left[0]), np.uint64(left[1])):
                if pixels[row, column].marker == m:
                    pixels[row, column].marker = len(markers)
        for column in range(np.uint64(first), np.uint64(after)):
            pixels[row, column].marker = m
