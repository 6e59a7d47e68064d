"""From fitted discs to given places: lag, backlash, and what the neighbours say.

Backlash: a fitted disc stays behind its marker, whichever way it moves.

A pixel fires when its level has changed by a step. The foot of a disc's edge, which has not risen
by one yet, is still ground on the map, and what has not fallen by one is still disc: the fit is
held back by a share of the way in which the edge crosses a step, at any speed. So it is no lag; it
is the play of a gear. After a marker turns round it is worse: each pixel must first cross its dead
band back, and those that have not yet hold the fit. Against truth (simulated, v2e) a fit is 0.04 px
behind in steady motion, 0.24 px half a px after a turn, and has caught up after 4 to 8 px; on a
flawed gel, whose steps and edges are larger, it is 0.1 and 0.23 px.

The given place is ahead of the fitted one by two play operators, a short one that tells the
direction of motion, and a long one that tells the fit's direction some px ago: a steady share of
the first, and a share of their difference, which is large after a turn and vanishes on the way. A
weighted sum of play operators (Krasnosel'skii and Pokrovskii 1989, doi:10.1007/978-3-642-61302-9)
is a Prandtl-Ishlinskii model, and this is its use as a compensator (Kuhnen 2003,
doi:10.3166/ejc.9.407-418). The shares and widths are ours.

A skin turns round as a whole, or nearly, and each fit notices it when its own pixels have crossed
their dead bands. So the direction is told together with the neighbours: some notice a turn sooner,
and nine jitter less than one. A neighbour counts as far as it went the same way before, by their
long operators: beside a contact, and around its middle, markers go ways of their own. (Simulated:
errors shrink by 2 to 7 % where the skin moves as a whole, and grow by less than 1 % in presses; if
all neighbours counted alike, by 16 % in presses.)
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.motion import AT_US, VX, VY, X, Y
from spikingtac.markers.neighbours import Neighbourhood, settle_kernel
from spikingtac.state_map.graded import Array

# Half of the way in which the direction of motion is told anew, in crossings (0.1 to 0.3
# are alike on the training scenes; below it is the fit's own jitter).
SHORT_PLAY = 0.2

# Half of the way in which a fit catches up after a turn, in crossings (3 to 6 are alike on
# the training scenes).
LONG_PLAY = 4.0

MOST_CROSSING_PX = 1.25  # Longest crossing: that of a pale marker (contrast 1.9).

# Background at which half of what pixels remember of a turn is gone: a pixel that noise lets fire
# begins anew (nothing is left to make good on training scenes at 1.2 Hz, everything at
# 0.2).
RENEWED_HZ_PX = 0.5

# A fit that goes farther than this at once was found elsewhere: its way says nothing.
LEAP_PX = 2.0

NO_WIDTH_PX = 1e-9  # Width of a play that is none.

# By how much a fit stays behind its marker in steady motion, as a share of the way in which an
# edge crosses one step (on the training scenes 0.05 to 0.2 are alike within 1 %).
STEADY_SHARE = 0.15

# By how much more it stays behind just after the marker turned round (chosen on the
# training scenes; both together shrink their errors by 5 %).
TURN_SHARE = 0.3

# Difference from the neighbours' prediction that is as likely an error of the fit as deformation,
# px, and how much more it is, in crossings (on the training scenes and others like v2e's:
# 0.1 and 0.15 px are alike; errors shrink by 8 and 15 %).
SHRINK_PX, SHRINK_CROSSINGS = 0.1, 0.3

SLOPE_POINTS = 401  # Points at which the slope of an edge is asked for its steepest.


def crossing_px(calibration: Calibration) -> NDArray[np.float64]:
    """Return the way in which the steepest part of each marker's edge crosses one step.

    Args:
        calibration: Steps and edges of the markers.

    Returns:
        ``(m,)`` px, at most :data:`MOST_CROSSING_PX`.
    """
    appearance = appearance_of(calibration)
    steepest = np.array(
        [
            np.abs(p.slope(np.linspace(-p.reach_px, p.reach_px, SLOPE_POINTS))).max()
            for p in appearance.profiles
        ]
    )
    return np.minimum(appearance.mean_step / steepest, MOST_CROSSING_PX)


class OutputCorrections:
    """Where the markers are, given where their discs were found."""

    def __init__(
        self, calibration: Calibration, neighbours: Neighbourhood, backlash: float, shrink: float
    ) -> None:
        """Begin at rest: nothing is known of the last motion.

        Args:
            calibration: Steps and edges of the markers.
            neighbours: What markers say of each other.
            backlash: Share of the backlash that is made good.
            shrink: Share of a fit's error by which differences from the neighbours shrink.
        """
        crossings, near = crossing_px(calibration), neighbours
        noise_px = shrink * (SHRINK_PX + SHRINK_CROSSINGS * crossings)
        skin = near.reference_px, near.index, near.weight
        self._sensor = crossings, *skin, noise_px, near.own_share, near.bound_px
        last_px = near.reference_px.copy()
        nothing = np.zeros_like(last_px)
        self._states = last_px, nothing, nothing.copy(), nothing.copy(), nothing.copy()
        self._backlash = backlash

    def update(
        self,
        t_us: int,
        motion: NDArray[np.float64],
        lag_s: float,
        known: bool,
        noise_hz_px: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return ``(m, 2)`` where the markers are, px, and ``(m,)`` which ones cannot be there.

        Args:
            t_us: The time, us.
            motion: ``(m, 8)`` states (:mod:`spikingtac.markers.graded.motion`).
            lag_s: Delay of the events, s.
            known: Whether it is known what an event stands for. Until the stream's loss was judged
                the steps are larger than that, and fits are ahead as often as behind: no backlash
                is made good.
            noise_hz_px: Events of a pixel at rest, 1/s.
        """
        share = self._backlash * known
        turning = TURN_SHARE * share / (1.0 + (noise_hz_px / RENEWED_HZ_PX) ** 2)
        given_px, outside = np.empty((len(motion), 2)), np.empty(len(motion), np.bool_)
        settings = float(t_us), lag_s, STEADY_SHARE * share, turning
        correct_kernel(motion, *self._sensor, *self._states, *settings, given_px, outside)
        return given_px, outside


@njit(cache=True, nogil=True, error_model="numpy")
def correct_kernel(
    motions: Array, crossings: Array, reference_px: Array, index: Array, weight: Array,
    noise_px: Array, own_share: Array, bound_px: Array, last_px: Array, direction: Array,
    way: Array, now_px: Array, ahead_px: Array, t_us: float, lag_s: float, steady: float,
    turning: float, given_px: Array, outside: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Bring every marker up to the present, and correct it; see :class:`OutputCorrections`.

    Arguments are plain, since a tuple costs a microsecond: the sensor's (motions, crossings, rests,
    neighbours, their weights, limits of :func:`settle_kernel`), states and scratch, and settings of
    :func:`lead_kernel`; results are the given places, and who is outside.
    """
    for m in range(crossings.size):
        since_s = (t_us - motions[m, AT_US]) * 1e-6
        now_px[m, 0] = motions[m, X] + since_s * motions[m, VX]
        now_px[m, 1] = motions[m, Y] + since_s * motions[m, VY]
    fits = now_px, motions[:, VX : VY + 1], crossings
    lead_kernel(fits, (last_px, direction, way), (lag_s, steady, turning), index, ahead_px)
    skin, limits = (reference_px, index, weight), (noise_px, own_share, bound_px)
    settle_kernel(ahead_px, skin, limits, given_px, outside)


@njit(cache=True, nogil=True, error_model="numpy")
def lead_kernel(
    fits: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    states: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    settings: tuple[float, float, float],
    neighbours: NDArray[np.int64],
    given_px: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move the play operators on by what the fits moved; write the places ahead of the fits.

    Args:
        fits: ``(m, 2)`` fitted places, px; ``(m, 2)`` their velocities, px/s; ``(m,)`` crossings,
            px.
        states: ``(m, 2)`` fitted places of the last call, px, and states of the short and the long
            operator, as shares of their widths; changed.
        settings: Delay of the events, s; shares in steady motion and after a turn.
        neighbours: ``(m, k)`` markers around each marker.
        given_px: ``(m, 2)`` result: fitted place, lag and play together, px.
    """
    fitted_px, velocity_px_s, crossings = fits
    last_px, direction, way = states
    lag_s, steady, turning = settings
    for m in range(crossings.size):
        dx, dy = fitted_px[m, 0] - last_px[m, 0], fitted_px[m, 1] - last_px[m, 1]
        last_px[m, 0], last_px[m, 1] = fitted_px[m, 0], fitted_px[m, 1]
        if dx * dx + dy * dy > LEAP_PX * LEAP_PX:
            dx, dy = 0.0, 0.0
        for play, state in ((SHORT_PLAY, direction), (LONG_PLAY, way)):
            width_px = max(play * crossings[m], NO_WIDTH_PX)
            x, y = state[m, 0] + dx / width_px, state[m, 1] + dy / width_px
            length2 = x * x + y * y
            share = 1.0 / np.sqrt(length2) if length2 > 1.0 else 1.0
            state[m, 0], state[m, 1] = x * share, y * share
    around = neighbours.shape[1]
    for m in range(crossings.size):
        x = y = 0.0
        own = float(around)
        for k in range(around):
            n = neighbours[m, k]
            alike = 1.0 - (way[n, 0] - way[m, 0]) ** 2 - (way[n, 1] - way[m, 1]) ** 2
            if alike > 0.0:
                x, y = x + alike * direction[n, 0], y + alike * direction[n, 1]
                own -= alike
        told = (x + own * direction[m, 0]) / around, (y + own * direction[m, 1]) / around
        for axis in range(2):
            ahead = crossings[m] * ((steady + turning) * told[axis] - turning * way[m, axis])
            given_px[m, axis] = fitted_px[m, axis] + lag_s * velocity_px_s[m, axis] + ahead
