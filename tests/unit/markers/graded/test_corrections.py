"""Lag, backlash and neighbours: what is made good, and what is left alone."""

import math

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.corrections import (
    LEAP_PX,
    LONG_PLAY,
    NO_WIDTH_PX,
    RENEWED_HZ_PX,
    SHORT_PLAY,
    SHRINK_CROSSINGS,
    SHRINK_PX,
    OutputCorrections,
    ReleasedZero,
    lead_kernel,
)
from spikingtac.markers.graded.tracker import GradedTrackerConfig
from spikingtac.markers.neighbours import Neighbourhood
from stand_ins.moving_rims import calibration

CROSSING_PX = 0.4


def ahead(
    path_px: np.ndarray, shares: tuple[float, float], neighbours: np.ndarray | None = None
) -> np.ndarray:
    """Return ``(n, m)`` how far markers are given ahead of fits that go along x, ``(n, m)`` px."""
    count = path_px.shape[1]
    alone = np.arange(count)[:, np.newaxis] if neighbours is None else neighbours
    states = tuple(np.zeros((3, count, 2)))
    states[0][:, 0] = path_px[0]
    out, given = [], np.empty((count, 2))
    for places in path_px:
        fits = np.column_stack([places, np.zeros(count)]), np.zeros((count, 2))
        lead_kernel((*fits, np.full(count, CROSSING_PX)), states, (0.0, *shares), alone, given)
        assert not given[:, 1].any()
        out.append(given[:, 0] - places)
    return np.array(out)


def plain(
    path_px: list[tuple[float, float]], start_px: tuple[float, float], play_px: float
) -> list[tuple[float, float]]:
    """Return the state of a marker's play operator after each place of its path."""
    state, last, given = (0.0, 0.0), start_px, []
    for place in path_px:
        moved = (place[0] - last[0], place[1] - last[1])
        last = place
        if math.hypot(*moved) <= LEAP_PX:
            state = (state[0] + moved[0], state[1] + moved[1])
        length = math.hypot(*state)
        if length > play_px:
            state = (state[0] / length * play_px, state[1] / length * play_px)
        given.append(state)
    return given


def test_the_kernel_does_what_the_plain_twin_does() -> None:
    rng = np.random.default_rng(3)
    start = rng.uniform(0.0, 100.0, (5, 2))
    steps = rng.normal(0.0, 0.08, (400, 5, 2))
    steps[150, 2] = 3.0, 0.0  # found elsewhere
    path = start + np.cumsum(steps, axis=0)
    crossings = np.array([0.0, 0.02, 0.1, 0.5, 1.0])
    direction, way = (
        np.array(
            [
                plain([tuple(place) for place in path[:, m]], tuple(start[m]), play * crossings[m])
                for m in range(5)
            ]
        )
        / np.maximum(play * crossings, NO_WIDTH_PX)[:, np.newaxis, np.newaxis]
        for play in (SHORT_PLAY, LONG_PLAY)
    )
    states, given = (start.copy(), np.zeros((5, 2)), np.zeros((5, 2))), np.empty((5, 2))
    velocity, lag_s, steady, turning = rng.normal(0.0, 50.0, (5, 2)), 2.4e-3, 0.15, 0.3
    neighbours = np.array([[1, 2], [4, 2], [3, 4], [4, 1], [1, 3]])  # the first has no play
    for k, places in enumerate(path):
        fits = places, velocity, crossings
        lead_kernel(fits, states, (lag_s, steady, turning), neighbours, given)
        for m in range(5):
            own, votes = 2.0, np.zeros(2)
            for n in neighbours[m]:
                apart = math.dist(way[n, k], way[m, k])
                own -= max(1.0 - apart**2, 0.0)
                votes += max(1.0 - apart**2, 0.0) * direction[n, k]
            told = (votes + own * direction[m, k]) / 2.0
            shift = crossings[m] * ((steady + turning) * told - turning * way[m, k])
            expected = places[m] + lag_s * velocity[m] + shift
            np.testing.assert_allclose(given[m], expected, atol=1e-12)
    assert np.hypot(*states[2].T).max() > 0.9


def test_after_a_turn_it_is_farther_ahead_and_the_fit_catches_up() -> None:
    way = np.concatenate([np.linspace(0.0, 10.0, 1001), np.linspace(10.0, 0.0, 1001)])
    shift = ahead(way[:, np.newaxis], (0.1, 0.3))[:, 0]
    np.testing.assert_allclose(shift[1000], 0.1 * CROSSING_PX)
    turned = 1001 + round(2.0 * SHORT_PLAY * CROSSING_PX / 0.01)
    assert shift[turned] < -0.55 * CROSSING_PX
    np.testing.assert_allclose(shift[-1], -0.1 * CROSSING_PX)
    assert (np.diff(shift[turned + 1 :]) > -1e-12).all()


def test_neighbours_tell_a_turn_and_those_that_went_another_way_do_not_count() -> None:
    neighbours = np.array([[1, 2], [0, 2], [0, 1]])
    turning = np.array([[0.0] * 3, [1.0] * 3, [1.0, 0.9, 0.9], [1.0, 0.8, 0.8]])
    shift = ahead(turning, (0.15, 0.3), neighbours)
    assert shift[3, 0] < shift[1, 0] - 0.4 * CROSSING_PX
    apart = np.array([[0.0] * 3, [0.0, 1.9, -1.9]])
    shift = ahead(apart, (0.15, 0.0), neighbours)[-1]
    np.testing.assert_allclose(shift, 0.15 * CROSSING_PX * np.array([0.0, 1.0, -1.0]))


def corrected(
    motion: np.ndarray, *, backlash: float = 1.0, known: bool = True, noise_hz_px: float = 0.0
) -> np.ndarray:
    """Return how far markers are given from their rests after one step of the filter's states."""
    sensor = calibration()
    neighbours = Neighbourhood(sensor.reference_px)
    made = OutputCorrections(sensor, neighbours, backlash, 0.0)
    states = np.zeros((len(sensor.reference_px), 8))
    states[:, :2] = sensor.reference_px
    states += motion
    return made.update(2_000, states, 2e-3, known, noise_hz_px)[0] - sensor.reference_px


def test_the_lag_is_made_good_from_the_last_time_of_the_filter_on() -> None:
    motion = np.array([0.0, 0.0, 40.0, -10.0, 0.0, 0.0, 0.0, 500.0])
    given = corrected(motion, backlash=0.0)
    np.testing.assert_allclose(given, np.tile([40.0 * 3.5e-3, -10.0 * 3.5e-3], (len(given), 1)))


def test_backlash_waits_until_a_step_is_known_and_fades_in_noise() -> None:
    motion = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2_000.0])
    crossings = crossing_px(calibration())
    steady = 0.15 * crossings
    for known, noise_hz_px, share in ((True, 0.0, 1.0), (True, RENEWED_HZ_PX, 0.5), (False, 0, 0)):
        given = corrected(motion, known=known, noise_hz_px=float(noise_hz_px))
        way = np.minimum(1.0 / (LONG_PLAY * crossings), 1.0)
        expected = known * (steady + share * 0.3 * crossings * (1.0 - way))
        np.testing.assert_allclose(given[:, 0] - 1.0, expected, atol=1e-6)


def test_a_lone_difference_shrinks_and_a_runaway_is_outside() -> None:
    sensor = calibration()
    neighbours = Neighbourhood(sensor.reference_px)
    made, marker = OutputCorrections(sensor, neighbours, 0.0, 1.0), len(sensor.reference_px) // 2
    states = np.zeros((len(sensor.reference_px), 8))
    states[:, :2] = sensor.reference_px
    noise_px = SHRINK_PX + SHRINK_CROSSINGS * crossing_px(sensor)[marker]
    states[marker, 0] += noise_px
    given, outside = made.update(0, states, 0.0, True, 0.0)
    left = given[marker, 0] - sensor.reference_px[marker, 0]
    assert left == pytest.approx((1.0 - 0.5 * neighbours.own_share[marker]) * noise_px, rel=1e-3)
    assert not outside.any()
    states[marker, 0] += 2.0 * neighbours.bound_px[marker]
    given, outside = made.update(0, states, 0.0, True, 0.0)
    assert np.flatnonzero(outside).tolist() == [marker]
    left = given[marker, 0] - sensor.reference_px[marker, 0]
    assert left == pytest.approx(neighbours.bound_px[marker])


@pytest.mark.parametrize("name", ["backlash", "shrink", "leak_per_s"])
def test_a_negative_share_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} is -0\.1, it must not be negative"):
        GradedTrackerConfig(**{name: -0.1})


REST_PX = np.array([[10.0, 10.0], [40.0, 10.0], [70.0, 10.0]])
LEFT_PX = np.array([[0.6, 0.0], [-0.3, 0.4], [0.0, -0.5]])
SEEN = np.zeros(3, bool)
DT_S = 0.01


def shown_px(
    zero: ReleasedZero, left_px: np.ndarray, seconds: float, speed_px_s: float = 0.0
) -> np.ndarray:
    """Hold the skin somewhere, moving or still; return the displacement that is given out."""
    velocity_px_s, given_px = np.full((3, 2), speed_px_s), REST_PX
    for _ in range(round(seconds / DT_S)):
        given_px = zero.update(REST_PX + left_px, velocity_px_s, SEEN, DT_S)
    return given_px - REST_PX


def pressed(zero: ReleasedZero) -> None:
    shown_px(zero, np.full((3, 2), 4.0), 0.2, speed_px_s=50.0)


def test_what_is_left_after_a_contact_is_taken_off() -> None:
    zero = ReleasedZero(Neighbourhood(REST_PX))
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, LEFT_PX, 1.0), 0.0, atol=1e-3)


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_soft_press_from_rest_stays(seconds: float) -> None:
    np.testing.assert_allclose(
        shown_px(ReleasedZero(Neighbourhood(REST_PX)), LEFT_PX, seconds),
        LEFT_PX,
        atol=1e-9,
    )


@pytest.mark.parametrize("left_px", [np.full((3, 2), 0.7), 6.0 * LEFT_PX, 2.0 * np.eye(3, 2)])
def test_a_press_that_is_held_is_no_rest(left_px: np.ndarray) -> None:
    zero = ReleasedZero(Neighbourhood(REST_PX))
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, left_px, 60.0), left_px, atol=1e-9)


def test_what_differs_from_marker_to_marker_is_no_press_where_the_same_size_alike_is() -> None:
    for left_px, rests in ((2.5 * LEFT_PX, True), (np.full((3, 2), 1.0), False)):
        zero = ReleasedZero(Neighbourhood(REST_PX))
        pressed(zero)
        assert np.linalg.norm(left_px, axis=1).mean() > 1.3
        np.testing.assert_allclose(
            shown_px(zero, left_px, 1.5), 0.0 if rests else left_px, atol=1e-3
        )


def test_markers_that_are_held_tell_nothing() -> None:
    zero, held = ReleasedZero(Neighbourhood(REST_PX)), np.array([False, False, True])
    pressed(zero)
    given_px = REST_PX
    for _ in range(100):
        given_px = zero.update(REST_PX + LEFT_PX, np.zeros((3, 2)), held, DT_S)
    np.testing.assert_allclose(given_px[:2], REST_PX[:2], atol=1e-3)
    np.testing.assert_allclose(given_px[2], REST_PX[2] + LEFT_PX[2], atol=1e-9)
    unseen = zero.update(REST_PX + LEFT_PX, np.zeros((3, 2)), np.ones(3, bool), DT_S)
    np.testing.assert_allclose(unseen, REST_PX + LEFT_PX, atol=1e-9)
