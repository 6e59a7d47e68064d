"""A marker that could not be followed goes where its neighbours go."""

from __future__ import annotations

import numpy as np

from spikingtac.markers.calibration.disc_levels import Course, led_by_neighbours


def test_a_stuck_marker_is_led_by_the_nearest_others() -> None:
    rest_px = np.array([[x, y] for y in (0.0, 10.0, 20.0) for x in (0.0, 10.0, 20.0)])
    shift_px = np.array([[0.0, 0.0], [3.0, 1.0], [5.0, -2.0]])[:, np.newaxis]
    # The skin is stretched as well, so that only neighbours tell the middle's way.
    center_px = rest_px + shift_px + 0.1 * shift_px[..., :1] * (rest_px - 10.0)
    stuck = np.arange(9) == 4
    seen = np.where(stuck[:, np.newaxis], rest_px, center_px)
    course = Course(np.arange(3), seen, np.ones((3, 9)))
    led = led_by_neighbours(course, 0, stuck)
    np.testing.assert_allclose(led.center_px, center_px, atol=1e-9)
    np.testing.assert_allclose(course.center_px[:, 4], rest_px[[4, 4, 4]])
