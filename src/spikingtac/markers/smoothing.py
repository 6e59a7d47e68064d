"""Tracks smoothed backward in time, with their uncertainty: for recordings that lie in a file.

A tracker knows the past alone. In a file the future is known as well: a Rauch-Tung-Striebel
smoother (Rauch, Tung, Striebel 1965, doi:10.2514/3.3166) runs back over the states of the tracker's
Kalman filters.

The filter's covariance, all but constant, tells of the scatter of fits alone. What a fit is off by
for longer is what the dead bands of its pixels hide: little of a marker that never moved, most of
one that went less than a px from its rest, and little for good once every pixel of the edge has
swung. A part is the error of the events' delay, in proportion to the speed. A pale or blurred
marker, whose edge crosses a step in a longer way, is less certain by as much. The standard
deviations were fitted to both of v2e's recordings, a simulated recorded sensor and five scenes of
the twin (simulated).
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.motion import PP, PV, STATE_US, VV, VX, VY, X, Y, predict_kernel
from spikingtac.markers.graded.tracker import GradedTracker
from spikingtac.markers.laws import OutputLaw
from spikingtac.markers.registry import MarkerTracker
from spikingtac.state_map.graded import Array
from spikingtac.types import MarkerFrame

SCATTER_PX = 0.05  # Standard deviation of places everywhere, px.

# Standard deviation of what dead bands hide at worst, px; the displacement where they do; and the
# farthest displacement so far from which they hide less.
DEAD_BAND_PX, DEAD_BAND_WAY_PX, SWUNG_PX = 0.16, 0.38, 1.5

DELAY_SHARE = 0.08  # Standard deviation of the delay's own error, as a share of it.

# Way in which an edge crosses a step from which deviations grow with it, px. (v2e's plain markers
# have 0.32 px, its flawed gel 0.45 px, the twin 0.2 px.)
CROSSING_PX = 0.28

# Standard deviation of a marker that is held, px: it is looked for within about as much.
LOST_PX = 10.0

# A marker that goes farther than this at once was found elsewhere: its way says nothing, px.
LEAP_PX = 2.0

# Columns of a state after those of its motion: what was given beyond the filter's place and its
# extrapolation, px; and whether the marker was held. Instead of a time there is how long ago, s.
AHEAD_X, AHEAD_Y, HELD = 8, 9, 10


def smoothed(
    frames: Iterable[MarkerFrame], tracker: MarkerTracker, law: OutputLaw
) -> Iterator[tuple[MarkerFrame, NDArray[np.float32]]]:
    """Yield frames smoothed backward, with the standard deviations ``(m, 2)`` of their places, px.

    Args:
        frames: Of a whole recording, as the tracker makes them.
        tracker: What makes them.
        law: From smoothed to given position.

    Raises:
        ConfigError: The tracker's states cannot be smoothed.
    """
    if not isinstance(tracker, GradedTracker):
        raise ConfigError(
            f"{type(tracker).__name__} cannot be smoothed: it has no filter with a covariance; "
            "smooth with the preset default or fast"
        )
    kept, states, lag_s = [], [], tracker.lag_s
    for frame in frames:
        kept.append(frame)
        states.append(state_of(frame, tracker.motion, lag_s))
    if not kept:
        return
    t_s = np.array([frame.t_us for frame in kept]) * 1e-6
    reference_px = kept[0].position_px - kept[0].displacement_px
    doubt = np.maximum(crossing_px(tracker.calibration) / CROSSING_PX, 1.0)
    places = smooth_places(t_s, np.array(states, np.float64), (reference_px, doubt), lag_s)
    for frame, place_px, sigma_px in zip(kept, *places, strict=True):
        position_px = law.update(place_px, reference_px)
        moved_px = position_px - reference_px
        given = {"detected_px": place_px, "position_px": position_px, "displacement_px": moved_px}
        yield replace(frame, **given), sigma_px


def state_of(frame: MarkerFrame, motion: NDArray[np.float64], lag_s: float) -> NDArray[np.float32]:
    """Return ``(m, 11)`` the state behind an estimate that a tracker just made.

    Args:
        frame: The estimate.
        motion: ``(m, 8)`` states of the filters (:mod:`spikingtac.markers.graded.motion`).
        lag_s: Delay of the events, s.
    """
    state = np.zeros((len(motion), 11))
    state[:, :STATE_US] = motion[:, :STATE_US]
    state[:, STATE_US] = since_s = (frame.t_us - motion[:, STATE_US]) * 1e-6
    late_s = lag_s + since_s[:, np.newaxis]
    given_px = motion[:, X : Y + 1] + late_s * motion[:, VX : VY + 1]
    state[:, AHEAD_X:HELD], state[:, HELD] = frame.detected_px - given_px, frame.coasted
    return state.astype(np.float32)  # a long recording is held in memory


def smooth_places(
    t_s: NDArray[np.float64],
    states: NDArray[np.float64],
    markers: tuple[NDArray[np.float64], NDArray[np.float64]],
    lag_s: float,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return ``(n, m, 2)`` places, px, and their standard deviations.

    Args:
        t_s: ``(n,)`` times of the estimates, s.
        states: ``(n, m, 11)`` from :func:`state_of`; changed.
        markers: ``(m, 2)`` rests, px; ``(m,)`` factors of their standard deviations.
        lag_s: Delay of the events, s.
    """
    reference_px, doubt = markers
    smooth_kernel(t_s, states)
    lag_px = lag_s * states[..., VX : VY + 1]
    place_px = states[..., X : Y + 1] + lag_px + states[..., AHEAD_X:HELD]
    sigma_px = doubt[:, np.newaxis] * place_sigma_px(place_px - reference_px, lag_px)
    sigma_px[states[..., HELD] > 0.0] = LOST_PX
    return place_px, sigma_px.astype(np.float32)


def place_sigma_px(
    displacement_px: NDArray[np.float64], lag_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``(n, m, 2)`` standard deviations of the places of plain markers, px, smoothed or not.

    Args:
        displacement_px: ``(n, m, 2)`` from the rests, px, since the beginning.
        lag_px: ``(n, m, 2)`` by how much the delay was made good, px.
    """
    away_px = np.linalg.norm(displacement_px, axis=-1, keepdims=True)
    way, swung = away_px / DEAD_BAND_WAY_PX, np.maximum.accumulate(away_px) / SWUNG_PX
    hidden_px = DEAD_BAND_PX * 2.0 * way / (1.0 + way * way) / np.sqrt(1.0 + swung * swung)
    return np.sqrt(SCATTER_PX**2 + hidden_px**2 + (DELAY_SHARE * lag_px) ** 2)


@njit(cache=True, nogil=True)
def smooth_kernel(t_s: Array, states: Array) -> None:  # pragma: no cover - compiled
    """Bring each state up to the time of its estimate, then smooth backward; all in place."""
    ahead = np.empty(8)
    for m in range(states.shape[1]):
        for k in range(len(t_s)):
            predict_kernel(states[k, m], states[k, m, STATE_US])
        for k in range(len(t_s) - 2, -1, -1):
            now, after = states[k, m], states[k + 1, m]
            dt_s = t_s[k + 1] - t_s[k]
            ahead[:] = now[:8]
            predict_kernel(ahead, dt_s)
            leapt = max(abs(after[X] - ahead[X]), abs(after[Y] - ahead[Y])) > LEAP_PX
            determinant = ahead[PP] * ahead[VV] - ahead[PV] * ahead[PV]
            if leapt or now[HELD] or after[HELD] or not determinant > 0.0:
                continue
            # Gain C = P F' P'^-1 of the textbook, for place and speed of either axis.
            pp, pv, vv = now[PP] + dt_s * now[PV], now[PV] + dt_s * now[VV], now[VV]
            c_pp = (pp * ahead[VV] - now[PV] * ahead[PV]) / determinant
            c_pv = (now[PV] * ahead[PP] - pp * ahead[PV]) / determinant
            c_vp = (pv * ahead[VV] - vv * ahead[PV]) / determinant
            c_vv = (vv * ahead[PP] - pv * ahead[PV]) / determinant
            for axis in range(2):
                place = after[X + axis] - ahead[X + axis]
                speed = after[VX + axis] - ahead[VX + axis]
                now[X + axis] += c_pp * place + c_pv * speed
                now[VX + axis] += c_vp * place + c_vv * speed
