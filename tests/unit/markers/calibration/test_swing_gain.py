"""What the events of full swings add up to, from states that are known."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.calibration.expected_levels import Walk
from spikingtac.markers.calibration.offset_memory import OffsetMemory
from spikingtac.markers.calibration.refine import swing_gain

MEMORY = OffsetMemory(4.0, 0.1)
STATES, SHAPE = 40, (40, 30)
CELL = np.repeat([0, 1], SHAPE[0] * SHAPE[1] // 2)


def seen(gains: tuple[float, float], swinging: float = 1.0) -> Walk:
    """Return pixels that are ground or marker by turns, with rims and unknown offsets in between.

    Args:
        gains: What the events of one full swing add up to near each of two markers.
        swinging: Share of the pixels that swing at all.
    """
    rng = np.random.default_rng(3)
    drawn = rng.choice([0.0, 0.5, 1.0], (STATES, *SHAPE), p=[0.4, 0.2, 0.4])
    drawn[:, rng.random(SHAPE) > swinging] = 0.0
    by_pixel = np.array(gains)[CELL].reshape(SHAPE)
    measured = by_pixel * drawn + rng.normal(0.0, 0.05, drawn.shape) + rng.normal(0.0, 0.5, SHAPE)
    # What rims send is not trusted, whatever it is.
    measured[drawn == 0.5] += 0.2
    drawn, measured = drawn.astype(np.float32), measured.astype(np.float32)
    return Walk(measured, drawn, drawn, np.zeros((2, 4)))


def test_swings_tell_the_gain_of_each_marker_whatever_the_counts_say() -> None:
    found = swing_gain(seen((0.85, 1.05)), MEMORY, CELL, counted=np.array([1.0, 1.1]))
    assert found == pytest.approx([0.85, 1.05], abs=0.015)


def test_a_marker_without_swings_follows_the_sensor() -> None:
    """The sensor's swings add up to a tenth less than its counts say: so do this marker's."""
    one_still = seen((0.9, 0.9))
    quiet = (CELL == 1).reshape(SHAPE)
    for level in (one_still.measured, one_still.drawn):
        level[:, quiet] = 0.0
    found = swing_gain(one_still, MEMORY, CELL, counted=np.array([1.0, 1.2]))
    # The counts' median is that of the two markers.
    assert found[1] / 1.2 == pytest.approx(0.9 / 1.1, abs=0.03)
