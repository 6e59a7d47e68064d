"""What the events of full swings add up to, beside what counts of events say."""

import numpy as np
import pytest

from spikingtac.markers.calibration.refine import swing_gain


def test_swings_tell_the_gain_of_each_marker_and_of_one_without() -> None:
    swings = np.array([[0.85, 1.0], [1.05, 1.0], [0.0, 0.0]]) * 5_000
    found = swing_gain(swings, np.array([1.0, 1.1, 1.2]), full=1e5)
    assert found == pytest.approx([0.85, 1.05, 0.95], abs=0.015)


def test_counts_tell_it_where_no_pixel_swings() -> None:
    counted = np.array([1.0, 1.1, 1.3])
    assert swing_gain(np.zeros((3, 2)), counted, full=0.0) == pytest.approx(counted)
