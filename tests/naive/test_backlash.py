"""The backlash kernel against a plain twin."""

import math

import numpy as np

from spikingtac.markers.graded.backlash import LEAP_PX, lead_kernel


def plain(
    path_px: list[tuple[float, float]], start_px: tuple[float, float], play_px: float
) -> list[tuple[float, float]]:
    """Return the offset of one marker after each place of its path."""
    offset, last, given = (0.0, 0.0), start_px, []
    for place in path_px:
        moved = (place[0] - last[0], place[1] - last[1])
        last = place
        if math.hypot(*moved) <= LEAP_PX:
            offset = (offset[0] + moved[0], offset[1] + moved[1])
        length = math.hypot(*offset)
        if length > play_px:
            offset = (offset[0] / length * play_px, offset[1] / length * play_px)
        given.append(offset)
    return given


def test_the_kernel_does_what_the_plain_twin_does() -> None:
    rng = np.random.default_rng(3)
    start = rng.uniform(0.0, 100.0, (5, 2))
    steps = rng.normal(0.0, 0.08, (400, 5, 2))
    steps[150, 2] = 3.0, 0.0  # found elsewhere
    path = start + np.cumsum(steps, axis=0)
    play = np.array([0.0, 0.02, 0.1, 0.15, 1.0])
    expected = [
        plain([tuple(place) for place in path[:, m]], tuple(start[m]), play[m]) for m in range(5)
    ]
    last, offset, given = start.copy(), np.zeros((5, 2)), np.empty((5, 2))
    velocity, lag_s = rng.normal(0.0, 50.0, (5, 2)), 2.4e-3
    for k, places in enumerate(path):
        lead_kernel(places, velocity, lag_s, last, play, offset, given)
        offsets = np.array([one[k] for one in expected])
        np.testing.assert_allclose(offset, offsets, atol=1e-12)
        np.testing.assert_allclose(given, places + lag_s * velocity + offsets, atol=1e-12)
    assert np.hypot(*offset.T).max() > 0.1
