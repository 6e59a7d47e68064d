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
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.motion import AT_US, VX, VY, X, Y
from spikingtac.markers.neighbours import Neighbourhood, settle_kernel
from spikingtac.state_map.graded import Array

# Half of the way in which the direction of motion is told anew, in crossings (0.1 to 0.3
# are alike on the training scenes; below it is the fit's own jitter).
SHORT_PLAY = 0.2

# Half of the way in which a fit catches up after a turn, in crossings (3 to 6 are alike on
# the training scenes).
LONG_PLAY = 4.0

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

LOADED_PX = 1.5  # Mean displacement from which there is a contact.

# Mean and largest displacement up to which the skin may have been released, each marker averaged
# with its neighbours: what pixels forget differs from marker to marker, a press does not. (The
# recorded sensor leaves up to 0.54 and 1.47 px behind, calibrated from half of its contacts; its
# presses are 2.4 px and more.)
NEAR_PX, NEAR_MOST_PX = 0.65, 1.6

FARTHEST_PX = 3.5  # The same for a marker by itself (the recorded sensor up to 3.0 px).

STILL_PX_S = 3.0  # Mean speed below which the skin stands still: the jitter of a filtered velocity.

# How long the skin stands still before the zero follows what is left; how long it follows; and
# the time constant of that.
WAIT_S, LEARN_S, SETTLE_S = 0.1, 2.0, 0.1


FADE_PX = 2.0  # Displacement of a marker at which a third of it is still taken off.


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
        limits = np.array([crossings, noise_px, near.own_share, near.bound_px])
        self._sensor = limits, *near.skin
        self._states = np.zeros((5, len(crossings), 2))
        self._states[0] = near.reference_px
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
        correct_kernel(motion, *self._sensor, self._states, *settings, given_px, outside)
        return given_px, outside


@njit(cache=True, nogil=True, error_model="numpy")
def correct_kernel(
    motions: Array, limits: Array, reference_px: Array, index: Array, weight: Array,
    states: Array, t_us: float, lag_s: float, steady: float, turning: float, given_px: Array,
    outside: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Bring every marker up to the present, and correct it; see :class:`OutputCorrections`.

    Arguments are few and plain, since an array costs 0.2 us and a tuple a microsecond: motions;
    ``(4, m)`` crossings and limits of :func:`settle_kernel`; rests, neighbours and their weights;
    ``(5, m, 2)`` states and scratch; settings of :func:`lead_kernel`; results are the given places,
    and who is outside.
    """
    crossings, noise_px, own_share, bound_px = limits[0], limits[1], limits[2], limits[3]
    last_px, direction, way = states[0], states[1], states[2]
    now_px, ahead_px = states[3], states[4]
    for m in range(crossings.size):
        since_s = (t_us - motions[m, AT_US]) * 1e-6
        now_px[m, 0] = motions[m, X] + since_s * motions[m, VX]
        now_px[m, 1] = motions[m, Y] + since_s * motions[m, VY]
    fits = now_px, motions[:, VX : VY + 1], crossings
    lead_kernel(fits, (last_px, direction, way), (lag_s, steady, turning), index, ahead_px)
    skin, bounds = (reference_px, index, weight), (noise_px, own_share, bound_px)
    settle_kernel(ahead_px, skin, bounds, given_px, outside)


@njit(cache=True, nogil=True, error_model="numpy")
def lead_kernel(
    fits: tuple[Array, Array, Array],
    states: tuple[Array, Array, Array],
    settings: tuple[float, float, float],
    neighbours: Array,
    given_px: Array,
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


class ReleasedZero:
    """Learns what is left after each contact, and takes it off: for pixels that recover.

    Such pixels do not remember where their disc rested: each contact leaves fits beside their
    rests, half a pixel on the recorded sensor, at random from marker to marker. The gel does
    remember: after a release it stands still within 0.1 s. What is left then, near the rest, is
    taken off until the next contact has ended.

    It is learned only within a short time after a contact, and only if the markers, averaged with
    their neighbours, are near their rests: a static press is not taken for a rest, however long it
    lasts, nor is one that begins softly.
    """

    def __init__(self, neighbours: Neighbourhood) -> None:
        """Begin at rest, with nothing to take off."""
        self._reference_px = neighbours.reference_px
        own = np.arange(len(self._reference_px))[:, np.newaxis]
        self._around = np.hstack([own, neighbours.index])
        self._zero_px = np.zeros_like(self._reference_px)
        self._loaded, self._still_s = False, 0.0

    def update(
        self,
        detected_px: NDArray[np.float64],
        velocity_px_s: NDArray[np.float64],
        held: NDArray[np.bool_],
        dt_s: float,
    ) -> NDArray[np.float64]:
        """Return ``(m, 2)`` places less what the last contact left behind, px.

        Args:
            detected_px: ``(m, 2)`` places as they were fitted, px.
            velocity_px_s: ``(m, 2)`` velocities, px/s.
            held: ``(m,)`` markers that are not seen; they tell nothing.
            dt_s: Time since the last call, s.
        """
        left_px = detected_px - self._reference_px
        seen = ~held
        count = np.count_nonzero(seen)
        if not count:
            return detected_px.copy()
        # Sums over a count: the method mean takes three times as long for so few numbers.
        away_px = np.hypot(left_px[:, 0], left_px[:, 1])[seen]
        mean_away_px = float(away_px.sum()) / count
        speed_px_s = float(np.hypot(velocity_px_s[:, 0], velocity_px_s[:, 1])[seen].sum()) / count
        self._still_s = self._still_s + dt_s if speed_px_s < STILL_PX_S else 0.0
        if mean_away_px > LOADED_PX:
            self._loaded = True
        elif self._loaded and self._still_s > WAIT_S:
            smooth_px = np.linalg.norm(left_px[self._around].mean(axis=1), axis=1)
            near = smooth_px.mean() < NEAR_PX and smooth_px.max() < NEAR_MOST_PX
            if near and away_px.max() < FARTHEST_PX:
                share = -np.expm1(-dt_s / SETTLE_S)
                self._zero_px[seen] += share * (left_px - self._zero_px)[seen]
            self._loaded = self._still_s < LEARN_S
        left_px -= self._zero_px
        away2 = (left_px**2).sum(axis=1, keepdims=True)
        return detected_px - self._zero_px * np.exp(-away2 / FADE_PX**2)
