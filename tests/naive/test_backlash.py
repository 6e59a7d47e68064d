"""The backlash kernel against a plain twin."""

import math

import numpy as np

from spikingtac.markers.graded.backlash import (
    LEAP_PX,
    LONG_PLAY,
    NO_WIDTH_PX,
    SHORT_PLAY,
    lead_kernel,
)


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
            ahead = crossings[m] * ((steady + turning) * told - turning * way[m, k])
            expected = places[m] + lag_s * velocity[m] + ahead
            np.testing.assert_allclose(given[m], expected, atol=1e-12)
        np.testing.assert_allclose(states[1][1:], direction[1:, k], atol=1e-12)
        np.testing.assert_allclose(states[2][1:], way[1:, k], atol=1e-12)
    assert np.hypot(*states[2].T).max() > 0.9
