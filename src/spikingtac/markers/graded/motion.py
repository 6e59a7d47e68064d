"""The motion of markers: constant-velocity Kalman filters, and the pixels that they stand around.

White acceleration noise of density q (px^2/s^3) drives both axes; a fit measures the position with
standard deviation sigma once per ms. Faster estimates read nearly the same map, so that their
variance grows as their period shrinks.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.kernels import kernel
from spikingtac.state_map.graded import Array

# Finger motion and releases reach 1e4 px/s^2 within tens of ms, rests none. (At half of it v2e's
# recording errs by 1 % more, its flawed gel by 0.4 % less; at twice it by 1 % more, both.)
ACCELERATION_NOISE_PX2_S3 = 1.0e6

# Scatter of a fit from one ms to the next (measured: 0.03 to 0.06).
MEASUREMENT_SIGMA_PX = 0.05

# Time in which the map changes enough for the next measurement to be a new one.
MEASUREMENT_PERIOD_S = 1.0e-3

START_VELOCITY_PX_S = 100.0  # Standard deviation of the unknown velocity at the first estimate.

# Fewer events are looked at after this time, us: as long as a prediction serves (at 6 ms,
# 10,000 estimates a second err by 7 % more on v2e's recording).
LATE_US = 2_000

# A marker is fitted at a time of its own in every period, us, if enough events wait, and is
# predicted in between. (Once in 1 ms for all v2e's recording errs by 2 % less, and an estimate of
# markers in motion takes a third longer.) The shorter period holds after a fit so far from its
# prediction, px, and where SUDDEN times as many events wait as are enough: at a release a marker
# would be gone. Fits to dead bands always have it: in less too few pixels fire to tell a place.
PERIOD_US, HURRIED_US, MISSED_PX, SUDDEN = 2_000, 1_000, 0.12, 12

AT_ONCE = 1 << 30  # Events that are due for any marker.

NEVER_US = -(1 << 62)  # A time before all others, us: recordings may begin before zero.

# How far beyond a disc's edge events ask for a fit, too: a prediction may be off by so much.
FARTHER_PX = 1.0

MARKED_PX = 2.5  # Way after which a marker marks its pixels anew, px.

# Columns of a motion: place, px; velocity, px/s; the covariance of both axes; its time, us.
X, Y, VX, VY, PP, PV, VV, AT_US = range(8)

# Columns of a fit: place, px; its time, us; share of the edge that agrees with the disc; until
# when no event changed it, us; where the marker stood when its pixels were marked, px; when its
# outline was fitted last, us; how far from the prediction it was, px.
FIT_X, FIT_Y, FIT_US, AGREEMENT, SILENT_US, MARKED_X, MARKED_Y, OUTLINED_US, OFF_PX = range(9)


def resting_motion(position_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(m, 8)`` motions of markers that rest somewhere, px, from a time not yet known."""
    motion = np.zeros((len(position_px), 8))
    motion[:, X:VX] = position_px
    motion[:, PP], motion[:, VV] = MEASUREMENT_SIGMA_PX**2, START_VELOCITY_PX_S**2
    motion[:, AT_US] = NEVER_US
    return motion


@kernel(forceinline=True)
def predict_kernel(motion: Array, dt_s: float) -> None:  # pragma: no cover
    """Move one marker's state on by ``dt_s``."""
    pp, pv, vv, q = motion[PP], motion[PV], motion[VV], ACCELERATION_NOISE_PX2_S3
    motion[X] += dt_s * motion[VX]
    motion[Y] += dt_s * motion[VY]
    motion[PP] = pp + dt_s * (2.0 * pv + dt_s * vv) + q * dt_s**3 / 3.0
    motion[PV] = pv + dt_s * vv + 0.5 * q * dt_s**2
    motion[VV] = vv + q * dt_s


@kernel(forceinline=True)
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


@kernel(forceinline=True)
def asks_kernel(
    m: int, fits: Array, pending: Array, due: Array, dead_bands: bool, times_us: tuple[int, int]
) -> bool:  # pragma: no cover - compiled
    """Return whether a marker asks for a fit, and note since when it has been silent.

    ``times_us`` is that of the last estimate, and of this one.
    """
    before_us, t_us = times_us
    if pending[m] == 0:
        fits[m, SILENT_US] = t_us
    asked = pending[m] >= due[m] or t_us - fits[m, SILENT_US] >= LATE_US
    if pending[m] >= AT_ONCE or not asked:
        return asked
    hurried = dead_bands or fits[m, OFF_PX] >= MISSED_PX or pending[m] >= SUDDEN * due[m]
    period_us = HURRIED_US if hurried else PERIOD_US
    return before_us < t_us - (t_us + m * period_us // len(fits)) % period_us


@kernel(forceinline=True)
def _chord_kernel(
    x: float, y: float, radius: float, row: int, width: int
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Return the first pixel of a row in a circle, and that after the last."""
    half2 = radius * radius - (row - y) ** 2
    if half2 < 0.0:
        return 0, 0
    half = np.sqrt(half2)
    return max(0, int(np.ceil(x - half))), max(0, min(width, int(np.floor(x + half)) + 1))


@kernel()
def mark_kernel(
    pixels: Array, m: int, motions: Array, fits: Array, outline_px: Array, edge: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Mark the pixels around marker m with its number, and no longer those that it left."""
    outer = outline_px[m, 0] + edge[m, 1] + FARTHER_PX + MARKED_PX
    height, width = pixels.shape
    left_x, left_y, x, y = fits[m, MARKED_X], fits[m, MARKED_Y], motions[m, X], motions[m, Y]
    fits[m, MARKED_X], fits[m, MARKED_Y] = x, y
    top, bottom = min(y, left_y) - outer, max(y, left_y) + outer
    for row in range(max(0, int(np.ceil(top))), min(height - 1, int(np.floor(bottom))) + 1):
        first, after = _chord_kernel(x, y, outer, row, width)
        first_left, after_left = _chord_kernel(left_x, left_y, outer, row, width)
        for rim in ((first_left, min(after_left, first)), (max(first_left, after), after_left)):
            for column in range(np.uint64(rim[0]), np.uint64(rim[1])):
                if pixels[row, column].around == m:
                    pixels[row, column].around = len(fits)
        for column in range(np.uint64(first), np.uint64(after)):
            pixels[row, column].around = m
