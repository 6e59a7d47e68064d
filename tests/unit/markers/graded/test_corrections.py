"""Lag, backlash and neighbours: what is made good, and what is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.corrections import (
    FADING_PER_S,
    LONG_PLAY,
    SHORT_PLAY,
    SHRINK_PX,
    STEADY_SHARE,
    TURN_SHARE,
    OutputCorrections,
    ReleasedSkin,
)
from spikingtac.markers.graded.motion import resting_markers
from spikingtac.markers.graded.tracker import GradedTrackerConfig
from spikingtac.markers.neighbours import Neighbourhood
from stand_ins.known import moving_markers
from stand_ins.moving_rims import calibration

SENSOR = calibration()
SENSOR_PX = SENSOR.reference_px
CROSSING_PX = crossing_px(SENSOR)
COUNT = len(SENSOR_PX)


def given(
    path_px: np.ndarray,
    *,
    backlash: float = 1.0,
    shrink: float = 0.0,
    velocity_px_s: np.ndarray | float = 0.0,
    sensor: Calibration = SENSOR,
    noise_hz_px: float = 0.0,
) -> np.ndarray:
    """Return ``(n, m, 2)`` the given displacements of fits that go along ``(n, m, 2)`` px."""
    made = OutputCorrections(sensor, Neighbourhood(sensor.reference_px), shrink)
    out = []
    for place_px in path_px:
        markers = moving_markers(sensor.reference_px + place_px, velocity_px_s)
        given_px = made.update(0, markers, 2e-3, backlash, (noise_hz_px, 0.01))
        out.append(given_px - sensor.reference_px)
    return np.array(out)


def along_x(way_px: np.ndarray) -> np.ndarray:
    """Return displacements of all markers alike along x."""
    return np.repeat(way_px[:, np.newaxis, np.newaxis] * [1.0, 0.0], COUNT, axis=1)


def play(path_px: np.ndarray, width_px: np.ndarray, kept: float) -> np.ndarray:
    """Return the states of play operators along a path, as shares of their widths."""
    state, last, states = np.zeros(path_px.shape[1:]), np.zeros(path_px.shape[1:]), []
    for place_px in path_px:
        state = kept * state + (place_px - last) / width_px[:, np.newaxis]
        state = state / np.maximum(np.linalg.norm(state, axis=1, keepdims=True), 1.0)
        last = place_px
        states.append(state)
    return np.array(states)


def test_the_kernel_does_what_the_plain_twin_does() -> None:
    rng = np.random.default_rng(3)
    path_px = np.cumsum(rng.normal(0.0, 0.08, (400, COUNT, 2)), axis=0)
    velocity_px_s = rng.normal(0.0, 50.0, (COUNT, 2))
    near, kept = Neighbourhood(SENSOR_PX), np.exp(-FADING_PER_S * 0.5**2 * 0.01)
    told = play(path_px, SHORT_PLAY * CROSSING_PX, kept)[:, near.index].mean(axis=2)
    way = play(path_px, LONG_PLAY * CROSSING_PX, kept)
    assert np.linalg.norm(way, axis=2).max() > 0.9
    ahead = (STEADY_SHARE + TURN_SHARE) * told - TURN_SHARE * way
    ahead_px = path_px + 2e-3 * velocity_px_s + CROSSING_PX[:, np.newaxis] * ahead
    apart_px = ahead_px - (near.weight[..., np.newaxis] * ahead_px[:, near.index]).sum(axis=2)
    own = 1.0 / (1.0 + (near.weight**2).sum(axis=1))[:, np.newaxis]
    taken = own * SHRINK_PX**2 / ((apart_px**2).sum(axis=2, keepdims=True) + SHRINK_PX**2)
    found = given(path_px, shrink=1.0, velocity_px_s=velocity_px_s, noise_hz_px=0.5)
    np.testing.assert_allclose(found, ahead_px - taken * apart_px, atol=1e-9)


def test_after_a_turn_it_is_farther_ahead_and_the_fit_catches_up() -> None:
    way = np.concatenate([np.linspace(0.0, 10.0, 1001), np.linspace(10.0, 0.0, 1001)])
    shift = (given(along_x(way)) - along_x(way))[:, 0, 0] / CROSSING_PX[0]
    np.testing.assert_allclose(shift[1000], STEADY_SHARE, rtol=1e-6)
    turned = 1001 + round(2.0 * SHORT_PLAY * CROSSING_PX[0] / 0.01)
    assert shift[turned] < -STEADY_SHARE - 1.2 * TURN_SHARE
    np.testing.assert_allclose(shift[-1], -STEADY_SHARE, rtol=1e-6)
    assert (np.diff(shift[turned + 1 :]) > -1e-12).all()


def test_the_lag_is_made_good_from_the_last_time_of_the_filter_on() -> None:
    made = OutputCorrections(SENSOR, Neighbourhood(SENSOR_PX), 0.0)
    markers = moving_markers(SENSOR_PX, np.array([40.0, -10.0]), t_us=500)
    moved_px = made.update(2_000, markers, 2e-3, 0.0, (0.0, 0.0)) - SENSOR_PX
    np.testing.assert_allclose(moved_px, np.tile([40.0 * 3.5e-3, -10.0 * 3.5e-3], (COUNT, 1)))


def test_a_lone_difference_shrinks_and_contacts_and_rigid_motion_stay() -> None:
    near, marker = Neighbourhood(SENSOR_PX), COUNT // 2
    for away_px, share in ((SHRINK_PX, 0.5), (25.0 * SHRINK_PX, 0.0)):
        path_px = np.zeros((1, COUNT, 2))
        path_px[0, marker, 0] = away_px
        left_px = given(path_px, backlash=0.0, shrink=1.0)[0, marker, 0]
        wanted_px = (1.0 - share * near.own_share[marker]) * away_px
        assert left_px == pytest.approx(wanted_px, rel=2e-3)
    turned_px = SENSOR_PX @ np.array([[0.0, 0.05], [-0.05, 0.0]])[np.newaxis] + [4.0, -2.0]
    found_px = given(turned_px, backlash=0.0, shrink=1.0)
    np.testing.assert_allclose(found_px, turned_px, atol=0.01)


def test_a_marker_alone_is_where_it_was_found() -> None:
    lone = replace(SENSOR, reference_px=SENSOR_PX[:1], radius_px=SENSOR.radius_px[:1], grid=None)
    path_px = np.array([[[1.0, 2.0]]])
    found_px = given(path_px, backlash=0.0, shrink=1.0, sensor=lone)
    np.testing.assert_array_equal(found_px, path_px)


@pytest.mark.parametrize("name", ["backlash", "shrink", "leak_per_s"])
def test_a_negative_share_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} is -0\.1, valid are 0"):
        GradedTrackerConfig(**{name: -0.1})


REST_PX = np.array([[10.0, 10.0], [40.0, 10.0], [70.0, 10.0]])
LEFT_PX = np.array([[0.6, 0.0], [-0.3, 0.4], [0.0, -0.5]])
SEEN = np.zeros(3, bool)
DT_S = 0.01


def shown_px(
    zero: ReleasedSkin, left_px: np.ndarray, seconds: float, speed_px_s: float = 0.0
) -> np.ndarray:
    """Hold the skin somewhere, moving or still; return the displacement that is given out."""
    markers, given_px = resting_markers(REST_PX), REST_PX
    markers["vx"] = speed_px_s
    for _ in range(round(seconds / DT_S)):
        given_px = zero.update(REST_PX + left_px, markers, SEEN, DT_S)
    return given_px - REST_PX


def pressed(zero: ReleasedSkin) -> None:
    shown_px(zero, np.full((3, 2), 4.0), 0.2, speed_px_s=50.0)


@pytest.mark.parametrize(
    ("left_px", "seconds"),
    [
        (np.full((3, 2), 0.7), 60.0),
        (6.0 * LEFT_PX, 60.0),
        (2.0 * np.eye(3, 2), 60.0),
        (np.full((3, 2), 1.0), 1.5),  # no rest although it is as large as what is taken off
    ],
)
def test_a_press_that_is_held_is_no_rest(left_px: np.ndarray, seconds: float) -> None:
    zero = ReleasedSkin(Neighbourhood(REST_PX), recovers=True)
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, left_px, seconds), left_px, atol=1e-9)


@pytest.mark.parametrize(("left_px", "seconds"), [(LEFT_PX, 1.0), (2.5 * LEFT_PX, 1.5)])
def test_what_is_left_after_a_contact_and_differs_from_marker_to_marker_is_taken_off(
    left_px: np.ndarray, seconds: float
) -> None:
    zero = ReleasedSkin(Neighbourhood(REST_PX), recovers=True)
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, left_px, seconds), 0.0, atol=1e-3)


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_soft_press_from_rest_stays(seconds: float) -> None:
    given_px = shown_px(ReleasedSkin(Neighbourhood(REST_PX), recovers=True), LEFT_PX, seconds)
    np.testing.assert_allclose(given_px, LEFT_PX, atol=1e-9)


def test_markers_that_are_held_tell_nothing() -> None:
    zero, held = ReleasedSkin(Neighbourhood(REST_PX), recovers=True), np.array([False, False, True])
    pressed(zero)
    given_px, markers = REST_PX, resting_markers(REST_PX)
    for _ in range(100):
        given_px = zero.update(REST_PX + LEFT_PX, markers, held, DT_S)
    np.testing.assert_allclose(given_px[:2], REST_PX[:2], atol=1e-3)
    np.testing.assert_allclose(given_px[2], REST_PX[2] + LEFT_PX[2], atol=1e-9)
    unseen = zero.update(REST_PX + LEFT_PX, markers, np.ones(3, bool), DT_S)
    np.testing.assert_allclose(unseen, REST_PX + LEFT_PX, atol=1e-9)


@pytest.mark.parametrize(("left_px", "way_left"), [(LEFT_PX, 0.0), (6.0 * LEFT_PX, 1.0)])
def test_where_steps_are_large_the_filters_of_a_released_skin_are_drawn_to_rest(
    left_px: np.ndarray, way_left: float
) -> None:
    released = ReleasedSkin(Neighbourhood(REST_PX), recovers=False)
    markers = resting_markers(REST_PX)
    pressed(released)
    places_px, held = REST_PX + left_px, np.array([False, False, True])
    markers["x"], markers["y"] = places_px.T
    for _ in range(100):
        now_px = np.column_stack([markers["x"], markers["y"]])
        np.testing.assert_array_equal(released.update(now_px, markers, held, DT_S), now_px)
    found_px = np.column_stack([markers["x"], markers["y"]]) - REST_PX
    np.testing.assert_allclose(found_px[:2], way_left * left_px[:2], atol=1e-3)
    np.testing.assert_array_equal(found_px[2], left_px[2])
