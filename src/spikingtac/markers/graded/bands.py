"""Locate markers from the levels at which pixels fired: for sensors whose OFF events are rare.

A pixel that fired since the last estimate was at its level then: residual e = M - S(|x - c| - r)
with the variance of M. A pixel that did not fire lies in its band: it says something only where the
disc asks for a level outside of it, and then by how much. Both pull at the predicted centre, whose
variance is given, by a few Gauss-Newton steps (a maximum a posteriori estimate). Then each level is
corrected towards the fitted disc by its Kalman gain, so that thresholds that differ between pixels
do not add up. The idea of one state for pose and brightness is that of event-based mosaicing
(Kim et al. 2014, doi:10.5244/C.28.26).
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelWatch
from spikingtac.markers.graded.appearance import appearance_of, painted_map, profile_tables
from spikingtac.markers.graded.motion import (
    AGREEMENT,
    AT_US,
    MOST_VARIANCES,
    PP,
    PV,
    VV,
    VX,
    VY,
    Locator,
    X,
    Y,
    predict_kernel,
    rest_kernel,
)
from spikingtac.state_map.bands import BandStateMap
from spikingtac.state_map.graded import PAD_PX, Array
from spikingtac.types import EventPacket

# Shortest time between two fits, us: in less too few pixels fire to tell a place (simulated,
# every 0.1 ms: 0.27 px instead of 0.17).
SHORTEST_PERIOD_US = 1_000

# Variance of a disc's own level, shares of a swing squared: profiles are never exact.
MODEL_VARIANCE = 0.003

LARGEST_STEP_PX = 1.0  # A Gauss-Newton step is cut to this length.

SMALL_STEP_PX = 0.005  # A fit whose last step was shorter has converged.

# Residual at which a pixel counts half (Cauchy). Sharper, 3 standard deviations, is 3 % more
# accurate on presses and loses markers that snap back at 2,000 px/s (measured, simulated).
SOFT_RESIDUAL = 0.4

MOST_STEPS = 3  # Gauss-Newton steps per marker and estimate at most.

BAND_WEIGHT = 0.4  # Weight of a pixel that did not fire, over that of one that did.

MOST_GAIN = 0.3  # Largest share of a level's disagreement that one estimate corrects.

# Residual of an expected level at which a pixel counts half as agreeing, as in the disc fit.
SOFT_LEVEL = 0.8


class BandLocator(Locator):
    """Maximum a posteriori fits to a :class:`BandStateMap`, all markers at once."""

    def __init__(self, calibration: Calibration) -> None:
        """Tabulate the profiles of a sensor's markers."""
        tables = profile_tables(appearance_of(calibration).profiles)
        self._discs = calibration.radius_px.astype(np.float64), *tables
        self._bands = painted_map(calibration, BandStateMap)
        super().__init__(calibration, self._bands)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        super().reset()
        self.motion[:, PP], self.motion[:, VV] = MOST_VARIANCES

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        super().place(marker, position_px)
        self.motion[marker, PP:AT_US] = MOST_VARIANCES[0], 0.0, MOST_VARIANCES[1]

    def absorb(self, packet: EventPacket, watch: HotPixelWatch) -> None:
        """Bring the map up to date, and count the events by marker, but for those of hot pixels.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        kept = watch.kept(packet)
        self.map.absorb(kept)
        self.counts += np.bincount(self._owner[kept.y, kept.x], minlength=len(self.counts))

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Bring every marker up to ``t_us``, unless that was done just before.

        Args:
            t_us: The time, us.
            coasted: ``(m,)`` markers that are held: their motion stays.
        """
        if 0.0 <= self.motion[0, AT_US] > t_us - SHORTEST_PERIOD_US:
            return
        levels = self._bands
        maps = levels.memory, levels.variance, levels.fired, levels.signed_steps, levels.turn
        states = self.motion, self.fits, coasted
        fit_bands_kernel((*maps, levels.padded), states, self._discs, t_us)
        levels.turn += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _window_kernel(
    disc: tuple[float, float, float, float], shape: tuple[int, int]
) -> tuple[int, int, int, int]:  # pragma: no cover - compiled
    """Return first row and column, and those after the last, of the pixels around a disc."""
    x, y, radius_px, reach_px = disc
    far = radius_px + reach_px
    first = max(0, int(np.ceil(y - far))), max(0, int(np.ceil(x - far)))
    bottom, right = (
        min(shape[0], int(np.floor(y + far)) + 1),
        min(shape[1], int(np.floor(x + far)) + 1),
    )
    return first[0], first[1], max(bottom, 0), max(right, 0)


@njit(cache=True, nogil=True)
def _residual_kernel(apart: float, new: bool, steps: Array) -> float:  # pragma: no cover - compiled
    """Return how far a level is from a disc's: all of it where it is new, else beyond its band.

    ``steps`` are the pixel's falling (negative) and rising step: a level may lie above the disc's
    by an OFF step, and below by an ON step, without an event.
    """
    return apart if new else max(apart + steps[0], 0.0) + min(apart + steps[1], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations_kernel(
    maps: tuple[Any, ...], disc: tuple[float, float, float, float], table: Array, sums: Array
) -> None:  # pragma: no cover - compiled
    """Sum curvature (xx, xy, yy) and gradient (x, y) of the pixels around a disc.

    ``maps`` are those of :func:`fit_bands_kernel`; ``disc`` is x, y, radius and the table's reach,
    px.
    """
    memory, variance, fired, steps, turn, _ = maps
    x, y, radius_px, reach_px = disc
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    sums[:] = 0.0
    top, left, bottom, right = _window_kernel(disc, memory.shape)
    for row in range(top, bottom):
        for column in range(left, right):
            dx, dy = column - x, row - y
            rho = np.sqrt(dx * dx + dy * dy) + 1e-9
            place = (rho - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            new = fired[row, column] == turn
            e = _residual_kernel(memory[row, column] - table[0, entry], new, steps[row, column])
            if e == 0.0:
                continue
            weight = (1.0 if new else BAND_WEIGHT) / (variance[row, column] + MODEL_VARIANCE)
            weight /= 1.0 + e * e / SOFT_RESIDUAL**2
            slope = -table[2, entry]
            jx, jy = slope * dx / rho, slope * dy / rho
            sums[0] += weight * jx * jx
            sums[1] += weight * jx * jy
            sums[2] += weight * jy * jy
            sums[3] += weight * jx * e
            sums[4] += weight * jy * e


@njit(cache=True, nogil=True, error_model="numpy")
def correct_levels_kernel(
    maps: tuple[Any, ...],
    disc: tuple[float, float, float, float],
    table: Array,
    center_variance: float,
) -> float:  # pragma: no cover - compiled
    """Draw levels towards the fitted disc; return the share of its edge that agrees with them."""
    memory, variance, fired, steps, turn, padded = maps
    x, y, radius_px, reach_px = disc
    last = table.shape[1] - 1
    scale = 0.5 * last / reach_px
    agreeing, total = 0.0, 1e-6
    top, left, bottom, right = _window_kernel(disc, memory.shape)
    for row in range(top, bottom):
        for column in range(left, right):
            place = (np.hypot(column - x, row - y) - radius_px + reach_px) * scale
            if place < 0.0 or place >= last:
                continue
            entry = int(place)
            slope = -table[2, entry]
            apart = (padded[row + PAD_PX, column + PAD_PX] - table[0, entry]) / SOFT_LEVEL
            agreeing += slope / (1.0 + apart * apart)
            total += slope
            new = fired[row, column] == turn
            e = _residual_kernel(memory[row, column] - table[0, entry], new, steps[row, column])
            if e == 0.0:
                continue
            known = variance[row, column]
            gain = known / (known + MODEL_VARIANCE + slope * slope * center_variance)
            gain = min(gain, MOST_GAIN) / (1.0 + e * e / SOFT_RESIDUAL**2)
            memory[row, column] -= np.float32(gain * e)
            padded[row + PAD_PX, column + PAD_PX] -= np.float32(gain * e)
            if new:
                variance[row, column] = np.float32(known * (1.0 - gain))
    return agreeing / total


@njit(cache=True, nogil=True, error_model="numpy")
def solve_kernel(
    sums: Array, away: tuple[float, float], prior: float
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Return the Gauss-Newton step in x and y, px, and the variance of the place, px^2.

    ``away`` leads to the predicted place, ``prior`` is its variance.
    """
    xx, xy, yy = sums[0] + 1.0 / prior, sums[1], sums[2] + 1.0 / prior
    gx, gy = sums[3] + away[0] / prior, sums[4] + away[1] / prior
    determinant = xx * yy - xy * xy
    step_x, step_y = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
    return step_x, step_y, 0.5 * (xx + yy) / determinant


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_one_kernel(
    maps: tuple[Any, ...], motion: Array, disc: tuple[float, float, Array], sums: Array
) -> float:  # pragma: no cover - compiled
    """Correct one marker's predicted state, then the levels around it; return the agreement.

    ``disc`` is the radius and the table's reach, px, and the table.
    """
    radius_px, reach_px, table = disc
    px, py, prior = motion[X], motion[Y], motion[PP]
    x, y, posterior = px, py, prior
    for _ in range(MOST_STEPS):
        normal_equations_kernel(maps, (x, y, radius_px, reach_px), table, sums)
        step_x, step_y, posterior = solve_kernel(sums, (px - x, py - y), prior)
        length = np.hypot(step_x, step_y)
        share = LARGEST_STEP_PX / max(length, LARGEST_STEP_PX)
        x, y = x + share * step_x, y + share * step_y
        if length < SMALL_STEP_PX:
            break
    gain, speed_gain = max(1.0 - posterior / prior, 0.0), motion[PV] / prior
    motion[X], motion[Y] = x, y
    motion[VX] += speed_gain * (x - px)
    motion[VY] += speed_gain * (y - py)
    motion[VV] -= speed_gain * gain * motion[PV]
    motion[PP], motion[PV] = posterior, (1.0 - gain) * motion[PV]
    return correct_levels_kernel(maps, (x, y, radius_px, reach_px), table, posterior)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_bands_kernel(
    maps: tuple[Any, ...], states: tuple[Any, ...], discs: tuple[Any, ...], t_us: int
) -> None:  # pragma: no cover - compiled
    """Move every marker near which pixels fired, and correct the levels around it.

    Args:
        maps: Memory, variance, fired, signed steps, the turn, and the padded expected levels of
            :class:`~spikingtac.state_map.bands.BandStateMap`; the levels are changed.
        states: Motions and fits (:mod:`spikingtac.markers.graded.motion`), of which the agreement
            is kept where nothing fired; and which markers are held, whose motion stays. Changed.
        discs: ``(m,)`` radii at rest, px; values and reaches of
            :func:`~spikingtac.markers.graded.appearance.profile_tables`.
        t_us: The time, us.
    """
    fired, turn = maps[2], maps[4]
    motions, fits, coasted = states
    radius_px, tables, reach_px = discs
    sums = np.zeros(5)
    for m in range(radius_px.size):
        motion = motions[m]
        dt_s = (t_us - motion[AT_US]) * 1e-6 if motion[AT_US] >= 0.0 else 0.0
        motion[AT_US] = t_us
        x, y = motion[X], motion[Y]
        predict_kernel(motion, dt_s)
        disc = motion[X], motion[Y], radius_px[m], reach_px[m]
        top, left, bottom, right = _window_kernel(disc, fired.shape)
        if (fired[top:bottom, left:right] == turn).any():
            profile = radius_px[m], reach_px[m], tables[m]
            fits[m, AGREEMENT] = _fit_one_kernel(maps, motion, profile, sums)
        else:
            motion[X], motion[Y] = x, y
            rest_kernel(motion, dt_s)
        fits[m, 0], fits[m, 1] = motion[X], motion[Y]
        if coasted[m]:
            motion[X], motion[Y], motion[VX], motion[VY] = x, y, 0.0, 0.0
