"""The backward smoother against the textbook's matrices, and what it leaves alone."""

import numpy as np

from spikingtac.markers.graded.motion import (
    ACCELERATION_NOISE_PX2_S3,
    correct_kernel,
    predict_kernel,
    resting_markers,
)
from spikingtac.markers.smoothing import LOST_PX, place_sigma_px, smooth_places, state_of
from spikingtac.types import MarkerFrame

DT_S = 1e-3
COUNT = 200
LAG_S = 2e-3
REST_PX = np.array([[40.0, 30.0]])
MARKERS = REST_PX, np.array([2.0])  # a pale one


def filtered(path_px: np.ndarray) -> list[np.ndarray]:
    """Return the filter's states, one for each measured place."""
    markers, states = resting_markers(path_px[:1]), []
    for k, (x, y) in enumerate(path_px):
        predict_kernel(markers[0], DT_S)
        correct_kernel(markers[0], x, y, DT_S)
        markers["t_us"] = k * 1_000
        states.append(markers.copy())
    return states


def frame(k: int, place_px: np.ndarray, held: bool = False) -> MarkerFrame:
    places = place_px.copy(), place_px.copy(), place_px - REST_PX
    return MarkerFrame(k * 1_000, *places, np.array([held]), np.ones(1))


def run(states: list[np.ndarray], held: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """Smooth estimates that are half a px ahead of the filter and its delay."""
    kept = []
    for k, state in enumerate(states):
        kept.append(state_of(frame(k, given(state), k == held), state, LAG_S))
    return smooth_places(np.arange(len(states)) * 1e-3, np.array(kept), MARKERS, LAG_S)


def given(state: np.ndarray) -> np.ndarray:
    return np.column_stack([state[axis] + LAG_S * state["v" + axis] + 0.5 for axis in "xy"])


def textbook(states: np.ndarray, axis: str) -> np.ndarray:
    """Return the Rauch-Tung-Striebel places and speeds of one axis, by matrices."""
    f = np.array([[1.0, DT_S], [0.0, 1.0]])
    q = ACCELERATION_NOISE_PX2_S3 * np.array([[DT_S**3 / 3, DT_S**2 / 2], [DT_S**2 / 2, DT_S]])
    mean = np.column_stack([states[axis], states["v" + axis]])
    cov = [np.array([[s["var_p"], s["cov_pv"]], [s["cov_pv"], s["var_v"]]]) for s in states]
    for k in range(len(states) - 2, -1, -1):
        gain = cov[k] @ f.T @ np.linalg.inv(f @ cov[k] @ f.T + q)
        mean[k] += gain @ (mean[k + 1] - f @ mean[k])
    return mean


PATH_PX = REST_PX + np.cumsum(np.random.default_rng(0).normal(0.0, 0.1, (COUNT, 2)), axis=0)


def test_the_smoother_equals_the_textbook() -> None:
    states = filtered(PATH_PX)
    got_px, _ = run(states)
    for place_px, axis in zip(got_px[:, 0].T, "xy", strict=True):
        mean = textbook(np.concatenate(states), axis)
        np.testing.assert_allclose(place_px, mean[:, 0] + LAG_S * mean[:, 1] + 0.5, atol=2e-3)


def test_noise_shrinks_and_what_lies_before_a_hold_or_a_leap_is_left_alone() -> None:
    rng = np.random.default_rng(1)
    true_px = REST_PX + 5.0 * np.sin(np.arange(COUNT) / 30.0)[:, np.newaxis]
    states = filtered(true_px + rng.normal(0.0, 0.05, true_px.shape))
    given_px = np.concatenate([given(state) for state in states])
    smooth_px, _ = run(states)
    apart = [np.diff(places_px, n=2, axis=0).std() for places_px in (smooth_px[:, 0], given_px)]
    assert apart[0] < 0.5 * apart[1]
    alone_px, sigma_px = run(states, held=100)
    np.testing.assert_allclose(alone_px[100, 0], given_px[100], atol=1e-3)
    assert sigma_px[100].min() == LOST_PX > 10.0 * np.delete(sigma_px, 100, axis=0).max()
    for state in states[51:]:
        state["x"], state["y"] = state["x"] + 9.0, state["y"] + 9.0
    np.testing.assert_allclose(run(states)[0][50, 0], given_px[50], atol=1e-3)


def test_dead_bands_hide_a_motion_until_a_marker_went_far_and_speed_hides_more() -> None:
    way_px = np.array([[0.0, 0.0], [0.41, 0.0], [8.0, 0.0], [0.41, 0.0]])
    still, half, far, back = place_sigma_px(way_px, np.zeros((4, 2)))[:, 0]
    assert still < far < back < 0.07 < half < 0.17
    fast = place_sigma_px(way_px[2:3], np.array([[1.0, 0.0]]))[0]
    assert fast[0] > fast[1] + 0.03
