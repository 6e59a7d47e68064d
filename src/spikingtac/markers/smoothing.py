"""Tracks of recordings smoothed backward in time, with their standard deviations.

A Rauch-Tung-Striebel smoother (Rauch, Tung, Striebel 1965, doi:10.2514/3.3166) runs back over the
states of the tracker's Kalman filters.

The covariance of the filter, almost constant, describes only the scatter of fits. The slowly
varying error comes from the dead bands of the pixels. It is small for a marker that never moved,
and largest for one that moved by less than a px from its rest position. It stays small once every
pixel of the edge has made a full swing. A further part is the error of the events' delay,
proportional to the speed. The deviations of a pale or blurred marker grow with the length over
which its edge crosses a step. The model was fitted to both of v2e's recordings, a simulated
recorded sensor and five scenes of the twin (simulated).
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

SCATTER_PX = 0.05  # Standard deviation of the scatter of positions, px.

# Largest standard deviation by dead bands, px; the displacement at which it occurs, px; and the
# largest displacement so far from which it decreases, px.
DEAD_BAND_PX, DEAD_BAND_AT_PX, FULL_SWING_PX = 0.16, 0.38, 1.5

DELAY_SHARE = 0.08  # Standard deviation of the delay, as a share of the delay.

# Length over which an edge crosses a step, px, above which deviations grow in proportion. (v2e's
# plain markers have 0.32 px, its flawed gel 0.45 px, the twin 0.2 px.)
CROSSING_PX = 0.28

# Standard deviation of a lost marker, px: about the gate within which it is searched.
LOST_PX = 10.0

# Innovation above which a marker was found again elsewhere, px: the smoother stops there.
LEAP_PX = 2.0

# Columns of a state after those of the filter: correction of the given position beyond the filter's
# prediction, px; and whether the marker was coasted. The time is replaced by the age of the state,
# s.
CORRECTION_X, CORRECTION_Y, COASTED = 8, 9, 10


def smoothed(
    frames: Iterable[MarkerFrame], tracker: MarkerTracker, law: OutputLaw
) -> Iterator[tuple[MarkerFrame, NDArray[np.float32]]]:
    """Yield smoothed frames, with the standard deviations ``(m, 2)`` of their positions, px.

    Args:
        frames: Estimates of the tracker over a whole recording.
        tracker: The tracker.
        law: Output law from smoothed to given position.

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
    factor = np.maximum(crossing_px(tracker.calibration) / CROSSING_PX, 1.0)
    places = smooth_places(t_s, np.array(states, np.float64), (reference_px, factor), lag_s)
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
    state[:, CORRECTION_X:COASTED], state[:, COASTED] = frame.detected_px - given_px, frame.coasted
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
    reference_px, factor = markers
    smooth_kernel(t_s, states)
    lag_px = lag_s * states[..., VX : VY + 1]
    place_px = states[..., X : Y + 1] + lag_px + states[..., CORRECTION_X:COASTED]
    sigma_px = factor[:, np.newaxis] * place_sigma_px(place_px - reference_px, lag_px)
    sigma_px[states[..., COASTED] > 0.0] = LOST_PX
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
    way, swung = away_px / DEAD_BAND_AT_PX, np.maximum.accumulate(away_px) / FULL_SWING_PX
    hidden_px = DEAD_BAND_PX * 2.0 * way / (1.0 + way * way) / np.sqrt(1.0 + swung * swung)
    return np.sqrt(SCATTER_PX**2 + hidden_px**2 + (DELAY_SHARE * lag_px) ** 2)


@njit(cache=True, nogil=True)
def smooth_kernel(t_s: Array, states: Array) -> None:  # pragma: no cover - compiled
    """Bring each state up to the time of its estimate, then smooth backward; all in place."""
    predicted = np.empty(8)
    for m in range(states.shape[1]):
        for k in range(len(t_s)):
            predict_kernel(states[k, m], states[k, m, STATE_US])
        for k in range(len(t_s) - 2, -1, -1):
            now, after = states[k, m], states[k + 1, m]
            dt_s = t_s[k + 1] - t_s[k]
            predicted[:] = now[:8]
            predict_kernel(predicted, dt_s)
            leapt = max(abs(after[X] - predicted[X]), abs(after[Y] - predicted[Y])) > LEAP_PX
            determinant = predicted[PP] * predicted[VV] - predicted[PV] * predicted[PV]
            if leapt or now[COASTED] or after[COASTED] or not determinant > 0.0:
                continue
            # Gain C = P F' P'^-1 of the textbook, for place and speed of either axis.
            pp, pv, vv = now[PP] + dt_s * now[PV], now[PV] + dt_s * now[VV], now[VV]
            c_pp = (pp * predicted[VV] - now[PV] * predicted[PV]) / determinant
            c_pv = (now[PV] * predicted[PP] - pp * predicted[PV]) / determinant
            c_vp = (pv * predicted[VV] - vv * predicted[PV]) / determinant
            c_vv = (vv * predicted[PP] - pv * predicted[PV]) / determinant
            for axis in range(2):
                place = after[X + axis] - predicted[X + axis]
                speed = after[VX + axis] - predicted[VX + axis]
                now[X + axis] += c_pp * place + c_pv * speed
                now[VX + axis] += c_vp * place + c_vv * speed
