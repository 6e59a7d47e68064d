"""Backlash: a fitted disc stays behind its marker, whichever way it moves, and how it is made good.

A pixel fires when its level has changed by a step. The foot of a disc's edge, which has not risen
by one yet, is still ground on the map, and what has not fallen by one is still disc: the fit is
held back by a share of the way in which the edge crosses a step, at any speed. So it is no lag; it
is the play of a gear. Against truth (simulated) markers stay 0.06 px behind on v2e's sensors and
0.16 px on its flawed gel, whose steps and edges are twice as large.

The given place is ahead of the fitted one by as much as the fitted one came forward since it turned
round, up to that play: the inverse of a play operator (Visintin 1994, Differential Models of
Hysteresis, ch. III). Ours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.graded.appearance import Appearance

MOST_PLAY_PX = 0.15
"""Largest play that is made good. Where steps were scaled beyond what events stand for (recorded
gel: 3.8 times), their width says nothing of the play."""

LEAP_PX = 2.0
"""A fit that goes farther than this at once was found elsewhere: its way says nothing."""

SLOPE_POINTS = 401
"""Points at which the slope of an edge is asked for its steepest."""


def play_px(appearance: Appearance, share: float) -> NDArray[np.float64]:
    """Return the play of each marker.

    Args:
        appearance: Steps and edges of the markers.
        share: Play as a share of the way in which the steepest part of an edge crosses one step.

    Returns:
        ``(m,)`` px, at most :data:`MOST_PLAY_PX`.
    """
    steepest = np.array(
        [
            np.abs(p.slope(np.linspace(-p.reach_px, p.reach_px, SLOPE_POINTS))).max()
            for p in appearance.profiles
        ]
    )
    step = 0.5 * (appearance.step_on + appearance.step_off)
    return np.minimum(share * step / steepest, MOST_PLAY_PX)


class BacklashCompensation:
    """How far each marker is ahead of its fitted disc.

    Attributes:
        offset_px: ``(m, 2)`` from the fitted place to the marker, px.
    """

    def __init__(self, play: NDArray[np.float64], start_px: NDArray[np.float64]) -> None:
        """Begin at rest: nothing is known of the last motion.

        Args:
            play: ``(m,)`` play of each marker, px.
            start_px: ``(m, 2)`` where the markers begin, px.
        """
        self._play_px, self._no_play_px = play, np.zeros_like(play)
        self._last_px = start_px.astype(np.float64)
        self.offset_px = np.zeros_like(self._last_px)

    def update(
        self,
        fitted_px: NDArray[np.float64],
        velocity_px_s: NDArray[np.float64],
        lag_s: float,
        *,
        whole: bool = True,
    ) -> NDArray[np.float64]:
        """Take in where the discs were found; return where their markers are, ``(m, 2)``, px.

        The lag is made good in the same pass: NumPy's calls would cost as much again.

        Args:
            fitted_px: ``(m, 2)`` fitted places, px.
            velocity_px_s: ``(m, 2)`` their velocities, px/s.
            lag_s: Delay of the events, s.
            whole: Whether all events arrive. While some are lost steps are larger than what an
                event stands for, and fits are ahead as often as behind: no play is made good.
        """
        play = self._play_px if whole else self._no_play_px
        given_px = np.empty_like(self._last_px)
        offsets = self._last_px, play, self.offset_px
        lead_kernel(fitted_px, velocity_px_s, lag_s, *offsets, given_px)
        return given_px


@njit(cache=True, nogil=True)
def lead_kernel(
    fitted_px: NDArray[np.float64],
    velocity_px_s: NDArray[np.float64],
    lag_s: float,
    last_px: NDArray[np.float64],
    play: NDArray[np.float64],
    offset_px: NDArray[np.float64],
    given_px: NDArray[np.float64],
) -> None:  # pragma: no cover - compiled
    """Move offsets on by what the fits moved, up to the play; write the places ahead of the fits.

    Args:
        fitted_px: ``(m, 2)`` fitted places, px.
        velocity_px_s: ``(m, 2)`` their velocities, px/s.
        lag_s: Delay of the events, s.
        last_px: ``(m, 2)`` fitted places of the last call; changed.
        play: ``(m,)`` largest offset of each marker, px.
        offset_px: ``(m, 2)`` offsets; changed.
        given_px: ``(m, 2)`` result: fitted place, lag and offset together, px.
    """
    for m in range(play.size):
        dx, dy = fitted_px[m, 0] - last_px[m, 0], fitted_px[m, 1] - last_px[m, 1]
        last_px[m, 0], last_px[m, 1] = fitted_px[m, 0], fitted_px[m, 1]
        if dx * dx + dy * dy > LEAP_PX * LEAP_PX:
            dx, dy = 0.0, 0.0
        x, y = offset_px[m, 0] + dx, offset_px[m, 1] + dy
        length2 = x * x + y * y
        if length2 > play[m] * play[m]:
            shrunk = play[m] / np.sqrt(length2)
            x, y = x * shrunk, y * shrunk
        offset_px[m, 0], offset_px[m, 1] = x, y
        given_px[m, 0] = fitted_px[m, 0] + lag_s * velocity_px_s[m, 0] + x
        given_px[m, 1] = fitted_px[m, 1] + lag_s * velocity_px_s[m, 1] + y
