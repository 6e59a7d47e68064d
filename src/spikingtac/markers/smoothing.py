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
from spikingtac.markers.graded.motion import predict_kernel
from spikingtac.markers.graded.tracker import GradedTracker
from spikingtac.markers.laws import OutputLaw
from spikingtac.markers.registry import MarkerTracker
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray, MarkerFrame

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

# State behind an estimate: that of the filter; its age, s; correction of the given position beyond
# the filter's prediction, px; and whether the marker was coasted. KEPT holds a long recording.
FILTER = ("x", "y", "vx", "vy", "var_p", "cov_pv", "var_v")
FIELDS = (*FILTER, "age_s", "correction_x", "correction_y", "coasted")
STATE, KEPT = (np.dtype([(name, kind) for name in FIELDS]) for kind in (np.float64, np.float32))


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
        states.append(state_of(frame, tracker.markers, lag_s))
    if not kept:
        return
    t_s = np.array([frame.t_us for frame in kept]) * 1e-6
    reference_px = kept[0].position_px - kept[0].displacement_px
    factor = np.maximum(crossing_px(tracker.calibration) / CROSSING_PX, 1.0)
    places = smooth_places(t_s, np.array(states), (reference_px, factor), lag_s)
    for frame, place_px, sigma_px in zip(kept, *places, strict=True):
        position_px = law.update(place_px, reference_px)
        moved_px = position_px - reference_px
        given = {"detected_px": place_px, "position_px": position_px, "displacement_px": moved_px}
        yield replace(frame, **given), sigma_px


def state_of(frame: MarkerFrame, markers: NDArray[np.void], lag_s: float) -> NDArray[np.void]:
    """Return ``(m,)`` records of KEPT: the state behind an estimate that a tracker just made.

    Args:
        frame: The estimate.
        markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
        lag_s: Delay of the events, s.
    """
    state = np.zeros(len(markers), KEPT)
    for name in FILTER:
        state[name] = markers[name]
    state["age_s"] = age_s = (frame.t_us - markers["t_us"]) * 1e-6
    for axis, given_px in zip("xy", frame.detected_px.T, strict=True):
        predicted_px = markers[axis] + (lag_s + age_s) * markers["v" + axis]
        state["correction_" + axis] = given_px - predicted_px
    state["coasted"] = frame.coasted
    return state


def smooth_places(
    t_s: FloatArray, kept: NDArray[np.void], markers: tuple[FloatArray, FloatArray], lag_s: float
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return ``(n, m, 2)`` places, px, and their standard deviations.

    Args:
        t_s: ``(n,)`` times of the estimates, s.
        kept: ``(n, m)`` records from :func:`state_of`.
        markers: ``(m, 2)`` rests, px; ``(m,)`` factors of their standard deviations.
        lag_s: Delay of the events, s.
    """
    (reference_px, factor), states = markers, kept.astype(STATE)
    smooth_kernel(t_s, states)
    lag_px = lag_s * np.stack([states["vx"], states["vy"]], axis=-1)
    parts_px = [states[axis] + states["correction_" + axis] for axis in "xy"]
    place_px = np.stack(parts_px, axis=-1) + lag_px
    sigma_px = factor[:, np.newaxis] * place_sigma_px(place_px - reference_px, lag_px)
    sigma_px[states["coasted"] > 0.0] = LOST_PX
    return place_px, sigma_px.astype(np.float32)


def place_sigma_px(displacement_px: FloatArray, lag_px: FloatArray) -> FloatArray:
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
    scratch = np.empty(1, STATE)
    predicted = scratch[0]
    for m in range(states.shape[1]):
        for k in range(len(t_s)):
            predict_kernel(states[k, m], states[k, m].age_s)
        for k in range(len(t_s) - 2, -1, -1):
            now, after = states[k, m], states[k + 1, m]
            dt_s = t_s[k + 1] - t_s[k]
            scratch[0] = now
            predict_kernel(predicted, dt_s)
            x, y = after.x - predicted.x, after.y - predicted.y
            vx, vy = after.vx - predicted.vx, after.vy - predicted.vy
            p_pp, p_pv, p_vv = predicted.var_p, predicted.cov_pv, predicted.var_v
            determinant = p_pp * p_vv - p_pv * p_pv
            unknown = now.coasted or after.coasted or not determinant > 0.0
            if unknown or max(abs(x), abs(y)) > LEAP_PX:
                continue
            # Gain C = P F' P'^-1 of the textbook, for place and speed of either axis.
            pp, pv, vv = now.var_p + dt_s * now.cov_pv, now.cov_pv + dt_s * now.var_v, now.var_v
            c_pp = (pp * p_vv - now.cov_pv * p_pv) / determinant
            c_pv = (now.cov_pv * p_pp - pp * p_pv) / determinant
            c_vp = (pv * p_vv - vv * p_pv) / determinant
            c_vv = (vv * p_pp - pv * p_pv) / determinant
            now.x, now.y = now.x + c_pp * x + c_pv * vx, now.y + c_pp * y + c_pv * vy
            now.vx, now.vy = now.vx + c_vp * x + c_vv * vx, now.vy + c_vp * y + c_vv * vy
