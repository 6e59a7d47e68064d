"""Appearance of the markers, the map painted from it, and the look-up tables of the disc fit.

A calibration gives the edge profile and the step (the share of a full swing per event) of each
marker, or only of the sensor as a whole. A calibration written by hand gives neither.

The disc fit reads the pixels around an edge, and the edge's profile S
(:mod:`spikingtac.calibration.disc_profile`). S and its slope are approximated by polynomials where
the edge is steep: a compiler vectorises these, but neither a table nor an exponential. The pixels
of a window are sorted by their distance from the centre, so that the pixels of any annulus are
contiguous, and one window serves markers of every size.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile, Discs, nearest_rims
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.state_map.graded import HALF_STEP, PAD_PX, STEP_DEFAULT, GradedStateMap
from spikingtac.types import FloatArray

# Step above which discs are fitted to dead bands instead of levels. (On twelve of 25 simulated
# sensors, with larger steps of 0.32 to 0.56, dead bands err by 5 to 67 % less; on eleven of the
# thirteen with larger steps of 0.06 to 0.27 they err by up to 65 % more.)
LARGE_STEP = 0.3

# Median width of the edges above which dead bands take the place of levels, too, px: most pixels
# then swing in part, and nothing anchors their levels. (On ten simulated skins out of focus, with
# edges of 1.3 to 2.5 px, dead bands err by 20 to 67 % less; on four with 0.9 to 1.0 px by 14 to
# 30 % more. Without 30 % of the events three of four skins out of focus err by 14 to 140 % more.)
WIDE_EDGE_PX = 1.2

# Factors of the ON and OFF steps on sensors whose pixels recover: these adapt to a part of each
# darkening without an event. (Measured: on a recorded gel ON 1.4 to 2 with OFF 0.7 to 1 give 0.68
# to 0.77 px under load, 1 and 1 give 1.3; four simulated sensors are alike from 1 to 1.6.)
RECOVERING_STEPS = 1.4, 0.85

# Time after an event for which a pixel is blind, us, where it was not measured: usual biases give
# 50 to 200. (Simulated sudden releases err by 14 % less, slides and presses on another simulator by
# 6 to 10 %, also where it is 50 us; v2e's recordings the same.)
DEAD_US = 100.0

# Largest magnitude of a sum of the normal equations, in steps: it fits into 32 bits.
LARGEST_SUM = 2.0**30

# Decimals to which coefficients are rounded: linear algebra differs between processors in about the
# thirteenth (single precision has seven digits).
COEFFICIENT_DECIMALS = 6

# Approximates S within 0.002 and dS/dq within 3 % of its largest value, for every contrast and edge
# whose flat ends :data:`FLAT_SHARE` cuts off.
POLYNOMIAL_DEGREE = 7

# Slope of the edge, as a share of its steepest slope, below which the fit leaves pixels out: they
# hardly constrain the centre (mean errors on v2e's recording: 0.0744 px at 0.02, 0.0747 at 0.1,
# 0.0758 at 0.2).
FLAT_SHARE = 0.1

REACH_PX = 7.0  # Farthest from the radius that a fit reads, px (6 to 9 are alike within 1 %).
MOST_RADIUS_PX = 90.0  # Radius of the largest disc whose fit stays in the margin when it grows.

CURVE_POINTS = 2001  # Points at which the polynomials are fitted: more change nothing.

RING_PX = 0.25  # Resolution of distance in the index of the window's pixels, px.
LANES = 16  # Pixels in the widest vectors of processors (AVX-512, 512 bits of float32).
PHASES = 4  # Subpixel cells along a pixel's side; the window is sorted for each of them.


def steps_of(calibration: Calibration) -> FloatArray:
    """Return ``(2, m)`` shares of the full swing per ON and OFF event of each marker."""
    names = "step_on", "step_off"
    steps = np.array([calibration.of_each_marker(name, STEP_DEFAULT) for name in names])
    return steps * np.array(_step_shares(calibration))[:, np.newaxis]


def _step_shares(calibration: Calibration) -> tuple[float, float]:
    return RECOVERING_STEPS if calibration.recovery_s is not None else (1.0, 1.0)


def needs_dead_bands(calibration: Calibration) -> bool:
    """Return whether steps are so large, or edges so wide, that levels do not place a disc.

    Where pixels recover, every rest is an anchor, and levels do.
    """
    on, off = calibration.step_on or STEP_DEFAULT, calibration.step_off or STEP_DEFAULT
    wide = np.median(Discs.of(calibration).edge_px) > WIDE_EDGE_PX
    return calibration.recovery_s is None and bool(max(on, off) > LARGE_STEP or wide)


def dead_time_of(calibration: Calibration) -> float:
    """Return the time after an event for which a pixel is blind, us: measured, or a usual one."""
    return DEAD_US if calibration.dead_time_us is None else calibration.dead_time_us


def painted_map(calibration: Calibration, lead_steps: float = HALF_STEP) -> GradedStateMap:
    """Return the map of a sensor at rest; for ``lead_steps`` see :class:`GradedStateMap`."""
    levels, owner = painted_levels(calibration)
    own = steps_of(calibration)[:, owner]
    known = calibration.step_on_map, calibration.step_off_map
    for step, share, known_step in zip(own, _step_shares(calibration), known, strict=True):
        if known_step is not None:
            np.copyto(step, share * known_step, where=known_step > 0.0)
    return GradedStateMap(
        levels,
        *own.astype(np.float32),
        dark_markers=calibration.polarity == "dark",
        lead_steps=lead_steps,
    )


def painted_levels(calibration: Calibration) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return ``(height, width)`` levels of the discs at rest, and each pixel's nearest marker."""
    (owner, _, q_px), discs = nearest_rims(calibration), Discs.of(calibration)
    own = DiscProfile(discs.contrast[owner], discs.edge_px[owner])
    return own.level(q_px).astype(np.float32), owner


def crossing_px(calibration: Calibration) -> FloatArray:
    """Return the length over which the steepest part of each marker's edge crosses one step.

    Args:
        calibration: Steps and edges of the markers.

    Returns:
        ``(m,)`` px.
    """
    return steps_of(calibration).mean(axis=0) / Discs.of(calibration).steepest


def events_per_px(calibration: Calibration) -> FloatArray:
    """Return ``(m,)`` events of a stream without loss per px of each marker's motion.

    A pixel that is swept swings up and down once, as far as the disc's level at its distance from
    the line of motion. Either way takes swing / step - 1 events; both together take at least one
    where the swing is full, also with steps of 1 (a binary map).
    """
    discs, per_swing = Discs.of(calibration), (1.0 / steps_of(calibration)).sum(axis=0)
    away_px = np.arange(0.5 * RING_PX, discs.radius_px.max() + REACH_PX, RING_PX)[:, np.newaxis]
    swing = discs.level(away_px - discs.radius_px)
    return 2.0 * RING_PX * np.maximum(swing * per_swing - 2.0, swing).sum(axis=0)


class FitWindow(NamedTuple):
    """Look-up tables of the disc fit: pixels sorted by distance, and the markers' edge profiles.

    The pixel of the disc's centre is the origin. The tables exist for each of its ``f`` subpixel
    cells, with the cell's middle as the centre.

    Attributes:
        offset: ``int32[f, 3, n]`` offset of each pixel in the flat padded map, in rows, in columns.
        polar: ``float32[f, 5, n]`` distance from the centre, px, the direction (x, y) from it, and
            cosine and sine of twice the direction's angle.
        within: ``int32[f, k]`` number of pixels nearer to the centre than 0, 1, 2, ... RING_PX.
        coefficients: ``(m, 2, POLYNOMIAL_DEGREE + 1)`` float32 polynomials of each marker's S and
            -dS/dq over -1 (at the inner end of the edge) to 1.
        edge: ``float32[m, 3]`` inner and outer end of each edge relative to the radius, px; number
            of integer units for a weight of one in the sums of the fit.
    """

    offset: NDArray[np.int32]
    polar: NDArray[np.float32]
    within: NDArray[np.int32]
    coefficients: NDArray[np.float32]
    edge: NDArray[np.float32]


def fit_window(discs: DiscProfile, width_px: int, most_px: float) -> FitWindow:
    """Return the tables for discs and radii up to ``most_px`` on a sensor.

    ``width_px`` is the sensor's width, px.
    """
    farthest_px = math.ceil(most_px + REACH_PX)
    dy, dx = np.indices((2 * farthest_px + 2,) * 2).reshape(2, -1) - farthest_px
    rings_px = np.arange(0.0, farthest_px, RING_PX)
    middles_px = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    orders, polars, within = [], [], []
    for y_px, x_px in product(middles_px, middles_px):
        distance_px = np.hypot(dx - x_px, dy - y_px)
        order = np.argsort(distance_px, kind="stable")
        to_x, to_y = (dx - x_px) / distance_px, (dy - y_px) / distance_px
        polar = distance_px, to_x, to_y, to_x**2 - to_y**2, 2.0 * to_x * to_y
        orders.append(order)
        polars.append(np.array(polar)[:, order])
        within.append(np.searchsorted(distance_px[order], rings_px))
    most = np.max(within) + LANES
    order = np.array(orders)[:, :most]
    dx, dy = dx[order], dy[order]
    q_px = np.linspace(-REACH_PX, REACH_PX, CURVE_POINTS)
    steep = -discs.slope(q_px[:, np.newaxis]) > FLAT_SHARE * discs.steepest
    ends_px = np.array([q_px[steep.argmax(axis=0)], -q_px[steep[::-1].argmax(axis=0)]])
    coefficients = _polynomials(discs, ends_px)
    edge = np.column_stack([*ends_px, _units(coefficients, most)])
    offset = np.stack([dy * (width_px + 2 * PAD_PX) + dx, dy, dx], axis=1)
    return FitWindow(
        offset=offset.astype(np.int32),
        polar=np.array([polar[:, :most] for polar in polars], np.float32),
        within=np.array(within, np.int32),
        coefficients=coefficients,
        edge=edge.astype(np.float32),
    )


def _polynomials(discs: DiscProfile, ends_px: FloatArray) -> NDArray[np.float32]:
    """Return ``(m, 2, POLYNOMIAL_DEGREE + 1)`` coefficients of every disc's curves.

    All are fitted at once: one by one they would take 6 ms each, 6 s for a skin of 1,024 markers.
    """
    z = np.linspace(-1.0, 1.0, CURVE_POINTS)
    q_px = ends_px[0] + (ends_px[1] - ends_px[0]) * (z[:, np.newaxis] + 1.0) / 2.0
    curves = np.stack([discs.level(q_px), -discs.slope(q_px)], axis=2).reshape(CURVE_POINTS, -1)
    series = np.polynomial.polynomial.polyfit(z, curves, POLYNOMIAL_DEGREE)
    # In C order: the kernel vectorises only if the coefficients are contiguous.
    rows = np.round(series, COEFFICIENT_DECIMALS).T.reshape(ends_px.shape[1], 2, -1)
    return rows.astype(np.float32, order="C")


def _units(coefficients: NDArray[np.float32], pixels: int) -> FloatArray:
    """Return ``(m,)`` integer units of a weight of one: powers of two, which scale exactly."""
    z = np.linspace(-1.0, 1.0, CURVE_POINTS)
    slope = np.polynomial.polynomial.polyval(z, coefficients[:, 1].T.astype(np.float64))
    steepest = np.maximum(np.abs(slope).max(axis=1), 1.0)
    return np.exp2(np.floor(np.log2(LARGEST_SUM / (pixels * steepest**2))))
